"""Base parameters: the combinations of inertial parameters that a set of readings can determine at all.

Columns of the regressor are taken in a fixed order, nearest link first, first moments before inertias before
masses, and each is kept when it is independent of those kept before; the others are expressed by the kept
ones. For revolute joints that is the classical regrouping towards the base [Gautier1990]_, and for the paper's
two-joint PUMA it gives the twelve parameters of [Liu1998]_ in their form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.dynamics.channels import WRENCH_NAMES, Channels
from bayesid.dynamics.regressors import Kernel
from bayesid.robot import inertia
from bayesid.robot.robot import Robot

#: A column whose part outside the kept ones is below this share of its length counts as dependent. URDFs round
#: right angles to 1.5708, which tilts axes by 4e-6 and would otherwise pass for identifiable structure.
TOLERANCE = 3e-5
#: What of a combination of parameters may lie outside others for it to be one of these, relative to its length.
_OUTSIDE = 1e-4
_PREFERENCE = {"mcx": 0, "mcy": 1, "mcz": 2, "Ixy": 3, "Iyy": 4, "Ixz": 5, "Iyz": 6, "Izz": 7, "Ixx": 8, "m": 9}


def notation(names: Sequence[str]) -> list[str]:
    """The notation of the labels: ``joint2.mcx`` is ``m2 r2x``; other names stay."""
    bodies = list(dict.fromkeys(n.rpartition(".")[0] for n in names))
    out = []
    for name in names:
        body, _, kind = name.rpartition(".")
        place = bodies.index(body) + 1
        short = f"m{place}" if kind == "m" else f"m{place} r{place}{kind[2:]}" if kind.startswith("mc") else f"I{place}{kind[1:]}"
        out.append(short if body and kind in inertia.PARAMETERS else name)
    return out


@dataclass(frozen=True)
class BaseParameters:
    """Identifiable combinations ``base = matrix @ parameters``."""

    matrix: np.ndarray  # k, (r, p): a unit matrix in the kept columns, the regrouping in the others
    independent: np.ndarray  # indices of the kept columns (r,); regressor times parameters is these columns times ``base``
    parameter_names: tuple[str, ...]  # names of the p parameters behind
    #: Of each base parameter: exact with numbers, for reading, SI.
    names: tuple[str, ...]
    labels: tuple[str, ...]
    units: tuple[str, ...]
    #: How a constant offset of the wrench takes up the parameters that look like one (6, p), or None.
    absorbed: np.ndarray | None = None

    def __repr__(self) -> str:
        return f"<BaseParameters: {self.rank} combinations of {len(self.parameter_names)} parameters>"

    @property
    def rank(self) -> int:
        """Number of base parameters."""
        return len(self.independent)

    @property
    def short_names(self) -> list[str]:
        """One parameter to name each combination by, ``I2xy …``; no two are alike."""
        names = notation(self.parameter_names)
        several = np.count_nonzero(self.matrix, axis=1) > 1
        return [names[k] + (" …" if more else "") for k, more in zip(self.independent, several, strict=True)]

    @property
    def weight_in_offset(self) -> bool:
        """Whether an estimated offset holds weight that looks like one; not that of a sensor which turns enough."""
        return self.absorbed is not None and bool(self.absorbed.any())

    def effect_labels(self, names: Sequence[str]) -> list[str]:
        """Labels of effects' parameters by their names: of an estimated offset that holds weight, it and the weight."""
        rows = () if self.absorbed is None else self.absorbed
        holding = {f"sensor_offset@sensor.{axis}" for axis, row in zip(WRENCH_NAMES, rows, strict=False) if np.any(row)}
        return [f"{name} + weight" if name in holding else name for name in names]

    @property
    def invisible(self) -> tuple[str, ...]:
        """Parameters that influence no reading at all."""
        seen = np.abs(self.matrix).max(axis=0, initial=0.0) > 0
        return tuple(self.parameter_names[k] for k in np.flatnonzero(~seen).tolist())


def structural_base(
    robot: Robot, channels: Channels, *, gravity: bool = True, offset: bool = False, at_rest: bool = False,
    held: np.ndarray | None = None, columns: np.ndarray | None = None, seed: int = 0,
) -> BaseParameters:  # fmt: skip
    """Base parameters of a robot and its readings, for the richest possible motion.

    Without ``gravity`` of motion wrenches, from which it has been subtracted; with an ``offset`` beside constant offsets of a
    wrench that are estimated, so that what looks like one drops out; ``at_rest`` of static poses alone. ``held`` is where joints
    stand that do not move (n,) [rad or m], nan for those that do; default: all move. ``columns`` are indices of the parameters
    that are not known (k,); default: all. The result does not depend on the ``seed`` of the random states that the rank is taken
    on.
    """
    rng = np.random.default_rng(seed)
    count = max(60, 12 * len(robot.body_names))
    # Turning joints anywhere: the structure does not depend on limits. Rates of about 1 keep columns comparable.
    q = rng.uniform(-np.pi, np.pi, (count, robot.n))
    q[:, robot.prismatic] *= 0.2
    v, a = np.zeros((2, count, robot.n)) if at_rest else rng.normal(0.0, [[[1.0]], [[4.0]]], (2, count, robot.n))
    if held is not None:
        still = np.isfinite(held)
        q[:, still], v[:, still], a[:, still] = held[still], 0.0, 0.0
    columns = np.arange(len(robot.parameter_names)) if columns is None else columns
    rows = Kernel.of(robot, channels, columns).dynamics(q, v, a, gravity=gravity)
    wrench = [c for c, name in enumerate(channels.names) if offset and not name.startswith("tau")]
    constants = np.tile(np.eye(len(channels))[:, wrench], (count, 1))
    names, units = ([every[k] for k in columns.tolist()] for every in (robot.parameter_names, robot.parameter_units))
    return regroup(rows.reshape(len(constants), -1), names, units, constants)


def regroup(
    rows: np.ndarray,
    names: Sequence[str],
    units: tuple[str, ...] | list[str],
    nuisance: np.ndarray | None = None,
    tolerance: float = TOLERANCE,
) -> BaseParameters:
    """Split columns of regressor rows, or of a triangular factor of them (k, p), into independent ones and combinations of those.

    ``nuisance`` are columns that are estimated beside (k, o); combinations with them do not count as identifiable.
    ``tolerance`` is the relative length of what must remain of a column outside the kept ones. Columns that are zero to it are
    dropped before the others are brought to unit length: scaling first would blow rounding up and count it as information.
    """
    rows = np.asarray(rows, float)
    p = rows.shape[1]
    length = np.linalg.norm(rows, axis=0)
    visible = length > tolerance * length.max(initial=0.0)
    scaled = rows / np.where(visible, length, 1.0)
    extra = np.zeros((rows.shape[0], 0)) if nuisance is None else nuisance
    whole = np.zeros((rows.shape[0], extra.shape[1] + p), order="F")
    size = extra.shape[1]
    if size:
        whole[:, :size] = np.linalg.qr(extra)[0]
    kept = []
    for column in sorted(np.flatnonzero(visible).tolist(), key=lambda k: _order(names[k], k)):
        rest = scaled[:, column]
        basis = whole[:, :size]
        for _ in range(2):  # twice is enough for orthogonality to rounding
            rest = rest - basis @ (basis.T @ rest)
        if np.linalg.norm(rest) > tolerance:
            whole[:, size] = rest / np.linalg.norm(rest)
            size += 1
            kept.append(column)
    independent = np.sort(np.array(kept, int))
    matrix = np.zeros((len(independent), p))
    matrix[np.arange(len(independent)), independent] = 1.0
    absorbed = np.zeros((extra.shape[1], p))
    dependent = np.setdiff1d(np.flatnonzero(visible), independent)
    if len(dependent):
        left = np.column_stack([extra, scaled[:, independent]])
        solution = np.linalg.lstsq(left, rows[:, dependent], rcond=None)[0]
        solution[extra.shape[1] :] /= length[independent][:, None]
        # What is below the tolerance, in units in which both columns are of unit length, is no relation.
        relative = np.abs(solution) * np.concatenate([np.linalg.norm(extra, axis=0), length[independent]])[:, None]
        solution[relative < tolerance * length[dependent]] = 0.0
        matrix[:, dependent] = solution[extra.shape[1] :]
        absorbed[:, dependent] = solution[: extra.shape[1]]
    for array in (matrix, independent, absorbed):
        array.setflags(write=False)
    return BaseParameters(
        matrix=matrix,
        independent=independent,
        parameter_names=tuple(names),
        names=tuple(combination(row, names) for row in matrix),
        labels=tuple(combination(row, notation(names)) for row in matrix),
        units=tuple(units[k] for k in independent.tolist()),
        absorbed=absorbed if extra.shape[1] else None,
    )


def spanned(wanted: np.ndarray, known: np.ndarray, tolerance: float = _OUTSIDE) -> tuple[np.ndarray, np.ndarray]:
    """Combinations of parameters (k, p) by known ones (r, p): T with ``wanted = T known`` (k, r), and which are such (k,).

    ``tolerance`` is what may lie outside the known ones, relative to the length of each.
    """
    through = np.linalg.lstsq(known.T, wanted.T, rcond=None)[0].T
    outside = np.linalg.norm(through @ known - wanted, axis=1)
    return through, outside <= tolerance * np.linalg.norm(wanted, axis=1)


def unseen(wider: BaseParameters, found: BaseParameters) -> tuple[str, ...]:
    """Labels of combinations that are not among those found (not in the span of their rows)."""
    return tuple(label for label, there in zip(wider.labels, spanned(wider.matrix, found.matrix)[1], strict=True) if not there)


def further(wider: BaseParameters, found: BaseParameters) -> tuple[str, ...]:
    """Labels of combinations beyond those found and beyond each other: one for each that the wider ones show more."""
    basis, out = np.linalg.qr(found.matrix.T)[0], []
    for label, row in zip(wider.labels, wider.matrix, strict=True):
        rest = row - basis @ (basis.T @ row)
        rest -= basis @ (basis.T @ rest)
        if np.linalg.norm(rest) > _OUTSIDE * np.linalg.norm(row):
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
            out.append(label)
    return tuple(out)


def _order(name: str, position: int) -> tuple:
    """Masses last of all; otherwise link by link in the order of the parameters, then by preference."""
    kind = name.rsplit(".", 1)[-1]
    if kind not in _PREFERENCE:
        return (0, position, 0)
    return (kind == "m", position - position % 10, _PREFERENCE[kind])


def combination(row: np.ndarray, names: Sequence[str]) -> str:
    """A sum such as ``joint1.mcz + 0.2435 joint2.m``; unit factors are left out."""
    text = ""
    for k in np.flatnonzero(row).tolist():
        size = abs(row[k])
        factor = "" if abs(size - 1.0) < 1e-9 else f"{size:.4g} "
        sign = "-" if row[k] < 0 else "+"
        text += f" {sign} {factor}{names[k]}" if text else f"{'-' if row[k] < 0 else ''}{factor}{names[k]}"
    return text


def nearest_links(robot: Robot, base: BaseParameters, values: np.ndarray, determined: np.ndarray | None = None) -> np.ndarray:
    """Link parameters that have these base parameters and are nearest to the nominal ones.

    Minimises ``(phi - phi0)' M (phi - phi0)`` subject to ``K phi = b`` with M the constant pull-back metric of
    the nominal bodies [Lee2020]_, so that "near" means a small relative change of every link's mass
    distribution: ``phi = phi0 + M^-1 K' (K M^-1 K')^-1 (b - K phi0)``, (10 bodies,). ``values`` are b (r,); ``determined``
    says which base parameters to meet (r,), default all: the others may stay nominal.
    """
    keep = np.ones(base.rank, bool) if determined is None else determined
    matrix = base.matrix[keep]
    nominal = robot.nominal.ravel()
    scaled = np.zeros_like(matrix)
    for k, body in enumerate(robot.nominal):
        part = slice(10 * k, 10 * k + 10)
        scaled[:, part] = np.linalg.solve(inertia.pullback_metric(body), matrix[:, part].T).T
    gram = scaled @ matrix.T
    size = np.sqrt(np.diag(gram))
    step = np.linalg.solve(gram / np.outer(size, size), (values[keep] - matrix @ nominal) / size) / size
    return nominal + scaled.T @ step
