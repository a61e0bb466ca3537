"""Command lines on damaged folders, drawn by hypothesis."""

from __future__ import annotations

import contextlib
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
        """Do it; a file that is gone, or is a folder now, takes no more of it."""
        for _, change in self.damages:
            with contextlib.suppress(FileNotFoundError, IsADirectoryError):
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
#: What is taken for a file or a folder of another verb's results.
_TABLE = st.sampled_from(["{arm}/identification.csv", "{arm}/robot.urdf", "{arm}", "{arm}/experiment.toml", "nowhere", ""])
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
    "diagnose": {**_COMMON, "--reference": st.sampled_from(["{arm}", "nowhere", ""])},
    "watch": {**_COMMON},
    "calibrate": {
        "--reference": st.sampled_from(["{arm}", "nowhere", ""]),
        "--mass": _ANY,
        "--mass-std": _ANY,
        "--motions": _COMMON["--motions"],
        "--effects": _COMMON["--effects"],
        "--out": _OUT,
        "--seed": _ANY,
    },
    "payload": {
        **_COMMON,
        "--reference": st.sampled_from(["{arm}", "nowhere", ""]),
        "--joint": st.sampled_from(["joint2", "joint1", "x", ""]),
        "--frame": st.sampled_from(["link2", "tool0", "x", ""]),
        "--extent": _ANY,
    },
    "identifiability": {
        **_COMMON,
        "--trajectory": _TABLE,
        "--sensor-sets": st.sampled_from(["wrench", "torque", "x", "", ",", "both,both"]),
        "--noise": st.sampled_from(["force=0.5", "force=-1", "force=nan", "tau2=1e400", "=", "x", "torque=1,torque=2", ""]),
        "--tell": _SPECS,
        "--bandwidth": _ANY,
    },
    "accuracy": {
        **_FIT,
        "--method": _METHODS,
        "--runs": st.sampled_from(["0", "1", "-1", "x"]),
        "--twins": st.sampled_from(["2", "0", "-5", "x"]),
        "--estimate": _TABLE,
        "--sensors": _TABLE,
    },
    "excite": {
        "--tell": _SPECS,
        "--channel": _CHANNELS,
        "--criterion": st.sampled_from(["d", "a", "e", "condition", "quantity", "x", ""]),
        "--quantity": st.sampled_from(["payload@elbow", "joint2.mcx", "torque@nowhere.csv", "x", "@", ""]),
        "--kind": st.sampled_from(["fourier", "liu1998", "x"]),
        "--duration": _ANY,
        "--period": _ANY,
        "--harmonics": _ANY,
        "--rate": _ANY,
        "--joints": st.sampled_from(["shoulder", "elbow,elbow", "wrist", "", ",", "x"]),
        "--share": _ANY,
        "--torque-share": _ANY,
        "--acceleration": st.sampled_from(["1", "0", "-1", "1,2", "1,2,3", "nan", "1e400", "x", ""]),
        "--sensor-range": st.sampled_from(["10,1", "0,0", "1,1,1,1,1,1", "nan,1", "x", ""]),
        "--sensor-share": _ANY,
        "--mount-frequency": _ANY,
        "--margin": _ANY,
        "--ground": _ANY,
        "--diagnosability": _ANY,
        "--blocks": st.sampled_from(["parked", "all", "poses,x", "", ","]),
        "--stops": _ANY,
        "--settle": _ANY,
        "--read": _ANY,
        "--warm-start": st.sampled_from(["identification", "nowhere", "{arm}/identification.csv", "{arm}/robot.urdf", ""]),
        "--starts": _ANY,
        "--randoms": _ANY,
        "--seconds": st.sampled_from(["1", "0", "-1", "nan", "x"]),
        "--model": st.just("{arm}/model.toml"),
        "--seed": _ANY,
    },
    "bounds": {
        **_FIT,
        "--posterior": _TABLE,
        "--estimate": _TABLE,
        "--trajectory": _TABLE,
        "--urdfs": st.sampled_from(["0", "2", "-1", "x"]),
        "--prior-std": _ANY,
        "--configurations": st.sampled_from(["4", "0", "-1", "x"]),
    },
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
SHARES = {
    "check": 11, "identify": 5, "simulate": 5, "compare": 1, "diagnose": 1, "sample": 1, "identifiability": 3, "excite": 3,
    "accuracy": 1, "bounds": 1, "watch": 1, "payload": 1, "calibrate": 1,
}  # fmt: skip
#: What keeps a verb's run short, where a case does not say otherwise.
SHORT = {
    "sample": {"--longest": "1", "--draws": "200", "--chains": "2"},
    "accuracy": {"--runs": "0", "--twins": "2"},
    "excite": {"--duration": "4", "--randoms": "4", "--starts": "1", "--seconds": "1", "--rate": "50"},
    "bounds": {"--method": "wls", "--configurations": "4"},
}


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
    if verb == "watch":
        options = ["{arm}", *options]
    if verb == "accuracy" and draw(st.booleans()):
        options.append("--certificate")
    options += [part for name, value in SHORT.get(verb, {}).items() if name not in options for part in (name, value)]
    if "--model" in options or "--bounds" in options:
        damages.append(draw(model_file()))
    return Case(verb, tuple(options), tuple(damages))
