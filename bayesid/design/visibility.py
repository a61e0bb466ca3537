"""What motions show of every link parameter: alone, in a combination with others, or not at all.

The rows ``X = X_b K`` see the parameters through the base parameters' matrix K, and these motions through the part of them that
the rows determine: with the factor R of the rows, effects projected out, the columns of ``R K`` are regrouped once more
(`bayesid.dynamics.base_parameters.regroup`). A parameter is identified alone where it is the only entry of a row of that map.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesid.design.expected import Expected
from bayesid.dynamics.base_parameters import BaseParameters, regroup
from bayesid.regression.linalg import condition_number, determined_inverse, undetermined
from bayesid.robot import inertia

ALONE, COMBINATION, WEAK, EFFECT, UNEXCITED, NEVER = "alone", "combination", "weak", "effect", "not_excited", "never_visible"
#: What a class says of a link parameter.
WORDS = {
    ALONE: "identified alone",
    COMBINATION: "only in a combination",
    WEAK: "seen, but the expected error is larger than the body itself",
    EFFECT: "not told from an effect in the model",
    UNEXCITED: "not excited by this motion",
    NEVER: "never visible to this sensor",
}
#: A letter for each, for tables of many parameters.
LETTERS = {ALONE: "a", COMBINATION: "c", WEAK: "w", EFFECT: "e", UNEXCITED: "–", NEVER: "·"}
#: From what tells most to what tells least, by rank alone.
_ORDER = (ALONE, COMBINATION, EFFECT, UNEXCITED, NEVER)


@dataclass(frozen=True)
class BaseExpectation:
    """A combination that these motions show."""

    #: As of base parameters.
    name: str
    label: str
    unit: str
    std: float  # expected standard deviation
    #: How large it is when every body's mass distribution is uncertain by its own size; None where nothing is known of that.
    size: float | None
    kind: str  # ``alone``, ``combination``, or ``weak`` where the standard deviation exceeds the size
    #: Posterior over prior standard deviation with the nominal model as far as it is trusted; None without such a prior.
    prior_share: float | None = None


@dataclass(frozen=True)
class LinkExpectation:
    """What these motions show of one link parameter."""

    name: str  # of the link parameter
    kind: str  # a key of `WORDS`
    combinations: tuple[int, ...]  # which base parameters of the motions it is in, by number; where it tells most comes first
    #: ``alone``, ``combination`` or ``never_visible`` with the richest motion; None where that is not known.
    of_any_motion: str | None
    joints: tuple[str, ...] = ()  # joints that stood still, each of which would show more of it by moving
    sensor_sets: tuple[str, ...] = ()  # names of other sensor sets that would show more of it with some motion


@dataclass(frozen=True, eq=False)
class Shown:
    """The part of the base parameters that motions determine."""

    base: BaseParameters  # combinations that these motions show
    without_effects: BaseParameters  # the same if no effect were in the model but the sensor's offset
    factor: np.ndarray  # of the information about them, all effects projected out (r, r)
    condition: float  # condition number of the rows, effects that are determined included, with columns of unit length

    @property
    def covariance(self) -> np.ndarray:
        """Expected covariance of the combinations (r, r)."""
        inverse = determined_inverse(self.factor, undetermined(self.factor))
        return inverse @ inverse.T

    @property
    def std(self) -> np.ndarray:
        """Expected standard deviations (r,)."""
        return np.sqrt(np.diag(self.covariance))


def shown(expected: Expected, offset: Sequence[str] = ()) -> Shown:
    """The combinations that motions determine.

    ``offset`` are effect parameters that are part of the sensor set, as a fitted offset is, and not of the user's model.
    """
    whole = expected.base
    own = np.array([n in offset for n in expected.effect_names], bool)
    base = _regrouped(expected, np.ones(len(own), bool))
    full = expected.base_factor @ whole.matrix[:, base.independent]
    effects = expected.weighted[:, whole.rank :][:, ~expected.hidden[whole.rank :]]
    rows = np.hstack([expected.weighted[:, : whole.rank] @ whole.matrix[:, base.independent], effects])
    bare = base if own.all() else _regrouped(expected, own)
    return Shown(base, bare, np.asarray(np.linalg.qr(full, mode="r")), condition_number(rows))


def _regrouped(expected: Expected, estimated: np.ndarray) -> BaseParameters:
    """Combinations that the rows determine beside some effects; those of the richest motion where they determine all of them."""
    base = expected.base
    names = base.parameter_names
    kinds = [n.rpartition(".")[2] for n in names]
    units = [inertia.UNITS[inertia.PARAMETERS.index(k)] if k in inertia.PARAMETERS else "" for k in kinds]
    for k, unit in zip(base.independent.tolist(), base.units, strict=True):
        units[k] = unit
    rows = expected.factor[:, : base.rank] @ base.matrix
    found = regroup(rows, names, units, expected.effect_basis(estimated)) if len(rows) else base
    return base if found.rank == base.rank else found


def kinds_of(base: BaseParameters) -> list[str]:
    """``alone``, ``combination`` or ``never_visible`` for every parameter behind (P,)."""
    entries = base.matrix != 0.0
    lonely = entries.sum(axis=1) == 1
    seen, alone = entries.any(axis=0), entries[lonely].any(axis=0)
    return [ALONE if a else COMBINATION if s else NEVER for a, s in zip(alone, seen, strict=True)]


def base_expectations(found: Shown, size: np.ndarray | None, prior: np.ndarray | None = None) -> tuple[BaseExpectation, ...]:
    """Expected standard deviations of combinations, and what they are worth, by their sizes (r,) and a prior of links (P, P)."""
    base, std = found.base, found.std
    share = None if prior is None else np.divide(*std_with_prior(found.factor, base.matrix @ prior @ base.matrix.T))
    out = []
    for k, row in enumerate(base.matrix):
        weak = size is not None and std[k] > size[k]
        kind = WEAK if weak else ALONE if np.count_nonzero(row) == 1 else COMBINATION
        own = None if size is None else float(size[k])
        driven = None if share is None else float(share[k])
        out.append(BaseExpectation(base.names[k], base.labels[k], base.units[k], float(std[k]), own, kind, driven))
    return tuple(out)


def std_with_prior(rows: np.ndarray, prior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations by information (r, p) and a prior (p, p), and by the prior alone (p,).

    With the prior's covariance ``C = L L'``, R the information's factor and ``G = R L`` the covariance is ``L (1 + G'G)^-1 L'``.
    """
    size = np.sqrt(np.diag(prior))
    values, vectors = np.linalg.eigh(prior / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    _, s, vt = np.linalg.svd(rows @ root)
    share = np.ones(len(size))
    share[: len(s)] = 1.0 / np.sqrt(1.0 + s**2)
    return np.linalg.norm(root @ vt.T * share, axis=1), size


def link_expectations(
    found: Shown, bases: Sequence[BaseExpectation], richest: BaseParameters | None, sizes: np.ndarray | None
) -> list[LinkExpectation]:
    """What motions show of every link parameter.

    ``richest`` are base parameters of the richest motion where it is known, ``sizes`` those of the link parameters (P,), for
    how much each has of a combination; None: by the factors alone.
    """
    kinds, best = kinds_of(found.base), None if richest is None else kinds_of(richest)
    bare = kinds_of(found.without_effects)
    scale = np.ones(len(kinds)) if sizes is None else sizes
    out = []
    for k, name in enumerate(found.base.parameter_names):
        column = np.abs(found.base.matrix[:, k])
        inside = np.flatnonzero(column)
        share = column[inside] * scale[k] / np.maximum(np.abs(found.base.matrix[inside]) @ scale, 1e-300)
        inside = inside[np.argsort(-share, kind="stable")].tolist()
        if kinds[k] == NEVER:
            excited = bare[k] != NEVER
            kind = EFFECT if excited else NEVER if best is not None and best[k] == NEVER else UNEXCITED
        else:
            kind = WEAK if all(bases[i].kind == WEAK for i in inside) else kinds[k]
        out.append(LinkExpectation(name, kind, tuple(inside), None if best is None else best[k]))
    return out


def shows_more(first: str, second: str) -> bool:
    """Whether a class tells more of a parameter than another one."""
    return _ORDER.index(first) < _ORDER.index(second)


def of_rank(kind: str, link: LinkExpectation) -> str:
    """A class by rank alone: ``weak`` is what it would be with less noise."""
    return kind if kind != WEAK else ALONE if link.of_any_motion == ALONE else COMBINATION


def by_body(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Rows and columns of a table of parameters: bodies and their ten, or one row of all where they are no bodies'."""
    kinds = [n.rpartition(".")[2] for n in names]
    if names and kinds == list(inertia.PARAMETERS) * (len(names) // 10):
        return [n.rpartition(".")[0] for n in names[::10]], list(inertia.PARAMETERS)
    return [""], list(names)
