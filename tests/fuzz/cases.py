"""Command lines on damaged folders, drawn by hypothesis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from hypothesis import strategies as st

from tests.fuzz.mutations import (
    KINDS,
    NUMBERS,
    PLACES,
    bytes_damage,
    effects_damage,
    model_file,
    table_damage,
    toml_damage,
    urdf_damage,
)


@dataclass(frozen=True)
class Case:
    """A command line and what was done to the folder before; ``{arm}`` in an option is the folder.

    Attributes
    ----------
    verb, options
        What runs.
    damages
        Names of what was done, for the report of a failure, and what does it.
    """

    verb: str
    options: tuple[str, ...]
    damages: tuple[tuple[str, Callable[[Path], None]], ...] = field(default=())

    def __repr__(self) -> str:
        """All that is needed to see what failed."""
        return f"bayesid {self.verb} {' '.join(map(repr, self.options))}; " + "; ".join(name for name, _ in self.damages)

    def damage(self, folder: Path) -> None:
        """Do it."""
        for _, change in self.damages:
            change(folder)


_ANY = st.sampled_from([*NUMBERS[:19], "", "x"])
_MOTIONS = st.sampled_from(
    ["", ",", "identification", "validation", "identification,validation", "identification,identification", "$x$", "x" * 300]
)
_METHODS = st.sampled_from(
    ["ols", "wls", "gls", "ridge", "tls", "iv", "huber", "student", "sdp", "lmi", "", "x", "ols,ols", "irls", "tsvd"]
)
_CHANNELS = st.sampled_from(["wrench", "torque", "both", "x", ""])
_SPECS = st.lists(st.tuples(st.sampled_from([*sorted(KINDS), "x"]), st.sampled_from(PLACES)).map("".join), max_size=3).map(
    ",".join
)
_OUT = st.sampled_from(["{arm}", "{arm}/robot.urdf", "{arm}/robot.urdf/x", "/proc/nowhere", "x" * 300, "a/b/c", "."])
_COMMON = {
    "--channel": _CHANNELS,
    "--motions": _MOTIONS,
    "--effects": _SPECS,
    "--model": st.just("{arm}/model.toml"),
    "--seed": _ANY,
}
_FIT = {
    **_COMMON,
    "--filter-l": _ANY,
    "--filter-d": _ANY,
    "--bandwidth": _ANY,
    "--static": st.sampled_from(["motion", "joint", "x"]),
    "--bounds": st.sampled_from(["{arm}/model.toml", "{arm}/robot.urdf", "nowhere"]),
}
OPTIONS: dict[str, dict[str, st.SearchStrategy[str]]] = {
    "check": {"--out": _OUT, "--seed": _ANY},
    "identify": {**_FIT, "--method": _METHODS},
    "compare": {**_FIT},
    "sample": {
        **_FIT,
        "--draws": _ANY,
        "--chains": _ANY,
        "--prior": st.sampled_from(["nominal", "flat", "x"]),
        "--prior-std": _ANY,
        "--noise": st.sampled_from(["gaussian", "student", "x"]),
        "--engine": st.sampled_from(["hmc", "emcee", "x"]),
        "--longest": st.sampled_from(["0", "-1", "1", "x"]),
    },
    "diagnose": {**_COMMON},
    "simulate": {
        "--duration": _ANY,
        "--rate": _ANY,
        "--effects": _SPECS,
        "--model": st.just("{arm}/model.toml"),
        "--perturb": _ANY,
        "--force-std": _ANY,
        "--torque-std": _ANY,
        "--resolution": _ANY,
        "--position-std": _ANY,
        "--out": _OUT,
        "--seed": _ANY,
    },
}
#: How often each verb runs: those that take seconds seldom.
SHARES = {"check": 11, "identify": 5, "simulate": 5, "compare": 1, "diagnose": 1, "sample": 1}


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """A command line on a damaged folder."""
    verb = draw(st.sampled_from([verb for verb, share in SHARES.items() for _ in range(share)]))
    known = OPTIONS[verb]
    kinds = [
        bytes_damage(),
        toml_damage(),
        toml_damage(),
        effects_damage(),
        table_damage(),
        table_damage(),
        urdf_damage(),
        urdf_damage(),
    ]
    damages = draw(st.lists(st.one_of(kinds), max_size=2))
    chosen = draw(st.lists(st.sampled_from(sorted(known)), max_size=2 if damages else 3, unique=True))
    options = [part for name in chosen for part in (name, draw(known[name]))]
    if verb == "simulate" and draw(st.booleans()):
        options.append("--new")
    if verb == "compare":
        options += ["--methods", draw(st.sampled_from(["ols", "ols,tls", "sdp", "huber,iv"]))]
    if verb == "sample":
        options += [
            "--longest",
            "1",
            *([] if "--draws" in options else ["--draws", "200"]),
            *(["--chains", "2"] if "--chains" not in options else []),
        ]
    if "--model" in options or "--bounds" in options:
        damages.append(draw(model_file()))
    return Case(verb, tuple(options), tuple(damages))
