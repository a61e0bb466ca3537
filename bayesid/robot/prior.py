"""What is known of the links before the data: a nominal model and its uncertainty, and what links weigh where none is stated."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesid.argument_types import explains_types
from bayesid.errors import InputError
from bayesid.robot import inertia
from bayesid.robot.robot import Robot

#: A link is about this many times as long as it is thick, and about as dense as water [kg/m^3].
_SLENDERNESS, _DENSITY = 4.0, 1000.0
#: Radius of the links of a robot whose joints are all at one place [m].
_RADIUS = 0.05
#: Length from which a link without a mass is no mere frame, as those between the joints of a wrist are [m].
_LENGTH = 0.01
#: A body whose radius of gyration is less than this share of that of a link of its length is a point in its URDF alone.
_POINT_LIKE = 0.25
#: Relative standard deviation of a body that is guessed, of the mean of its robot's bodies.
GUESS_STD = 10.0


@explains_types
@dataclass(frozen=True, eq=False)
class Prior:
    """Link parameters ``phi ~ N(mean, precision^-1)``, restricted to bodies that can exist if ``physical``.

    Attributes
    ----------
    mean
        Nominal link parameters (P,).
    precision
        Inverse covariance (P, P); singular where nothing is known.
    bodies
        Which parameters are a body's ten, in `bayesid.robot.inertia.PARAMETERS`' order.
    physical
        Whether every body's pseudo-inertia is known to be positive semidefinite.
    """

    mean: np.ndarray
    precision: np.ndarray
    bodies: tuple[tuple[int, ...], ...]
    physical: bool = True

    def __repr__(self) -> str:
        return f"<Prior of {len(self.bodies)} bodies{', which can exist only' if self.physical else ''}>"

    @classmethod
    def nominal(cls, links: np.ndarray, rel_std: float, *, physical: bool = True) -> Prior:
        """Bodies near nominal ones, by the constant pull-back metric [Lee2020]_.

        ``precision = 2 M / rel_std^2`` with M of `bayesid.robot.inertia.pullback_metric`: with ``P0 = L L'`` the nominal
        pseudo-inertia, ``L^-1 (P - P0) L^-T`` is a symmetric matrix of independent normal numbers, with standard
        deviation ``rel_std`` on and ``rel_std / sqrt(2)`` off the diagonal. Mass and second moment about any
        plane then have that relative standard deviation, in any frame and unit.

        Parameters
        ----------
        links
            Nominal parameters, ten a body (b, 10) or (10 b,).
        rel_std
            Relative standard deviation, above 0.
        physical
            See the class.

        Raises
        ------
        InputError
            ``rel_std`` is not a positive number, or the links are not ten a body.
        """
        links = np.asarray(links, float)
        if links.size % 10:
            raise InputError(f"links have {links.size} numbers; give ten a body")
        if not (np.isfinite(rel_std) and rel_std > 0):
            raise InputError(f"rel_std = {rel_std}: give a positive number, such as 0.1")
        links = links.reshape(-1, 10)
        precision = np.zeros((links.size, links.size))
        for k, body in enumerate(links):
            part = slice(10 * k, 10 * k + 10)
            precision[part, part] = 2.0 / rel_std**2 * inertia.pullback_metric(body)
        bodies = tuple(tuple(range(10 * k, 10 * k + 10)) for k in range(len(links)))
        return cls(links.ravel(), precision, bodies, physical)

    @classmethod
    def warped(cls, links: np.ndarray, rel_std: float, *, physical: bool = True) -> Prior:
        """Bodies that are nominal ones scaled, shifted and warped.

        What a CAD model gets wrong is a body's mass, where its middle is and how it is spread, by a share of its own size, and
        not ten numbers on their own: a slender link's middle may well lie a good part of its small thickness off its axis, which
        the pull-back metric of `nominal` takes for almost impossible. The pseudo-inertia becomes ``(1 + s e) T P T'`` with an
        affine map T near the identity: a shift of the centre of mass by s times the radius of gyration along each axis, and a
        warp about it with every entry of standard deviation s / 2. Parameters and errors are those of `nominal`; ``rel_std`` is
        the share s, the relative standard deviation of every mass.
        """
        plain = cls.nominal(links, rel_std, physical=physical)
        precision = np.zeros_like(plain.precision)
        for body in plain.bodies:
            covariance = _warps(plain.mean[list(body)], rel_std)
            # A body without extent has directions that no warp reaches; a thousandth of the pull-back's reach is left.
            covariance += 1e-3 * np.linalg.inv(plain.precision[np.ix_(body, body)])
            size = np.sqrt(np.diag(covariance))
            precision[np.ix_(body, body)] = np.linalg.inv(covariance / np.outer(size, size)) / np.outer(size, size)
        return replace(plain, precision=precision)

    @classmethod
    def around(cls, links: np.ndarray, rel_std: float, guessed: np.ndarray) -> Prior:
        """Links of a robot: `warped` nominal ones, and guessed ones, whose size is not known either.

        A guess is as uncertain as the mean of all bodies is with ten times its own size (`nominal`), or ``rel_std`` times if that
        is more; where all bodies are guesses, ``rel_std`` is theirs.

        Parameters
        ----------
        links, rel_std
            See `nominal`.
        guessed
            Which bodies are guesses (b,), see `guessed_bodies`.

        Raises
        ------
        InputError
            As `nominal`.
        """
        prior = cls.warped(links, rel_std)
        if not np.any(guessed) or np.all(guessed):
            return prior
        usual = np.tile(np.reshape(links, (-1, 10)).mean(axis=0), len(guessed))
        wide = np.repeat(guessed, 10)
        guess = cls.nominal(usual, max(rel_std, GUESS_STD)).precision
        return replace(prior, precision=np.where(wide[:, None] & wide, guess, prior.precision))

    def widened(self, factor: float) -> Prior:
        """The same with all standard deviations multiplied by a factor."""
        return replace(self, precision=self.precision / factor**2)

    @property
    def root(self) -> np.ndarray:
        """W with ``W'W`` the precision (q, P); directions without any are left out."""
        size = np.sqrt(np.diag(self.precision))
        size[size == 0.0] = 1.0
        scaled = self.precision / np.outer(size, size)
        try:
            return np.linalg.cholesky(0.5 * (scaled + scaled.T)).T * size
        except np.linalg.LinAlgError:
            values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
            keep = values > 1e-13 * values[-1]
            return np.sqrt(values[keep])[:, None] * vectors[:, keep].T * size

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of all link parameters (P, P).

        Raises
        ------
        numpy.linalg.LinAlgError
            Nothing is known in some direction.
        """
        scale = np.sqrt(np.diag(self.precision))
        return np.linalg.inv(self.precision / np.outer(scale, scale)) / np.outer(scale, scale)


def _warps(body: np.ndarray, size: float) -> np.ndarray:
    """Covariance of a body's ten parameters with scale, shift and warp of this size (10, 10)."""
    pseudo, mass = inertia.pseudo_inertia(body), max(body[0], 1e-6)
    centre, radius = body[1:4] / mass, max(gyration_radius(body), 1e-4)
    maps = [radius * np.outer(np.eye(4)[k], np.eye(4)[3]) for k in range(3)]
    for i in range(3):
        for j in range(3):
            warp = np.zeros((4, 4))
            warp[i, j], warp[i, 3] = 0.5, -0.5 * centre[j]
            maps.append(warp)
    changes = [body] + [inertia.from_pseudo_inertia(m @ pseudo + pseudo @ m.T) for m in maps]
    # The shift's square, m d d': second order, but as large as a slender body's own thickness.
    for i, j in zip(*np.triu_indices(3), strict=True):
        square = np.zeros((4, 4))
        square[i, j] = square[j, i] = mass * radius**2 * min(size, 1.0)  # beyond its own size, a second order means nothing
        changes.append(inertia.from_pseudo_inertia(square))
    return size**2 * np.einsum("gi,gj->ij", changes, changes)


def gyration_radius(body: np.ndarray) -> float:
    """Root mean square distance of a body's mass (10,) from its centre of mass [m]."""
    mass = max(body[0], 1e-6)
    return float(np.sqrt(max(np.trace(inertia.pseudo_inertia(body)[:3, :3]) / mass - np.sum((body[1:4] / mass) ** 2), 0.0)))


def point_like(robot: Robot) -> np.ndarray:
    """Which joints' links have their mass next to one point in the URDF, and a length (n,): their inertias are placeholders."""
    usual = typical_links(robot)
    length = np.zeros(robot.n)
    np.maximum.at(length, robot.rod_joint, np.linalg.norm(robot.rods[:, 1] - robot.rods[:, 0], axis=1))
    return np.array([
        length[j] > _LENGTH and robot.nominal[j, 0] > 0.0
        and gyration_radius(robot.nominal[j]) < _POINT_LIKE * gyration_radius(usual[j])
        for j in range(robot.n)
    ], bool)  # fmt: skip


def states_masses(robot: Robot) -> bool:
    """Whether the URDF gives any moving link a mass."""
    return bool((robot.nominal[:, 0] > 0.0).any())


def typical_links(robot: Robot) -> np.ndarray:
    """Ten parameters a body (b, 10): cylinders of water along the lines from each joint to the next, balls where there is none.

    A guess of shapes, to be near to where nothing else is known; all share one thickness, a quarter of their mean length.
    """
    length = np.linalg.norm(robot.rods[:, 1] - robot.rods[:, 0], axis=1)
    real = length > 1e-3
    radius = float(length[real].mean()) / (2.0 * _SLENDERNESS) if real.any() else _RADIUS
    out = np.zeros((len(robot.body_names), 10))
    for k in range(len(out)):
        own = np.flatnonzero(real & (robot.rod_joint == k)) if k < robot.n else []
        ends = [(robot.rods[i, 0], robot.rods[i, 1], np.pi * radius**2 * length[i]) for i in own]
        ends = ends or [(np.zeros(3), np.zeros(3), 4.0 / 3.0 * np.pi * radius**3)]
        pseudo = np.zeros((4, 4))
        for a, b, volume in ends:
            # Second moment of a uniform line from a to b, and of its thickness.
            line = (np.outer(a, a) + np.outer(b, b)) / 3.0 + (np.outer(a, b) + np.outer(b, a)) / 6.0
            middle = 0.5 * (a + b)
            second = line + 0.25 * radius**2 * np.eye(3)
            pseudo += _DENSITY * volume * np.block([[second, middle[:, None]], [middle[None], np.ones((1, 1))]])
        out[k] = inertia.from_pseudo_inertia(pseudo)
    return out


def with_sizes(links: np.ndarray) -> np.ndarray:
    """Parameters (b, 10) or (10 b,) of bodies as (b, 10), a ball of water for one without a mass, whose size is not known."""
    mass = _DENSITY * 4.0 / 3.0 * np.pi * _RADIUS**3
    ball = inertia.from_pseudo_inertia(mass * np.diag([*np.full(3, _RADIUS**2 / 5.0), 1.0]))
    bodies = np.reshape(links, (-1, 10))
    return np.where(bodies[:, :1] == 0.0, ball, bodies)


def natural_sizes(links: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """How uncertain combinations (r, 10 b) of links' parameters are, every body's mass distribution by its own size (r,)."""
    covariance = Prior.nominal(with_sizes(links), 2.0**0.5).covariance
    return np.sqrt(np.einsum("ij,jk,ik->i", matrix, covariance, matrix))


def filled_links(robot: Robot) -> np.ndarray:
    """Nominal parameters of every body (b, 10), with typical ones of a body that has no mass, as of a tool that no URDF holds."""
    weightless = robot.nominal[:, :1] == 0.0
    return np.where(weightless, typical_links(robot), robot.nominal) if weightless.any() else robot.nominal


def drawn_without_inertial(robot: Robot) -> np.ndarray:
    """Which joints' links have a shape or a length, and no ``<inertial>`` (n,)."""
    links = {str(link.get("name")): link for link in robot.description.root.findall("link")}
    out = np.zeros(robot.n, bool)
    for j, name in enumerate(robot.joint_names):
        link = links[robot.description.joints[name].child]
        drawn = link.find("visual") is not None or link.find("collision") is not None
        rods = robot.rods[robot.rod_joint == j]
        long = robot.nominal[j, 0] == 0.0 and bool((np.linalg.norm(rods[:, 1] - rods[:, 0], axis=1) > _LENGTH).any())
        out[j] = link.find("inertial") is None and (drawn or long)
    return out


def guessed_bodies(robot: Robot) -> np.ndarray:
    """Which bodies a guess stands for, as the URDF does not say what they weigh (b,): all where it states no mass at all.

    Else those without a mass that have a shape or a length, and what a sensor in a fixed joint carries, as a rule a tool. Any
    other body of mass 0 is a frame, and weighs nothing.
    """
    if not states_masses(robot):
        return np.ones(len(robot.nominal), bool)
    tool = np.ones(len(robot.nominal) - robot.n, bool)
    return np.concatenate([drawn_without_inertial(robot), tool]) & (robot.nominal[:, 0] == 0.0)


def assumed_links(robot: Robot) -> np.ndarray:
    """Nominal parameters of every body (b, 10), and typical ones of `guessed_bodies`."""
    guessed = guessed_bodies(robot)
    return np.where(guessed[:, None], typical_links(robot), robot.nominal) if guessed.any() else robot.nominal


def robot_prior(robot: Robot, rel_std: float) -> Prior:
    """`Prior.around` the robot's `assumed_links`."""
    return Prior.around(assumed_links(robot), rel_std, guessed_bodies(robot))
