"""``payload`` and ``calibrate`` on real recordings whose payload is known from elsewhere.

``python -m tests.studies.payload_real DATA WILD`` from the repository runs it on ``kuka-med-wrist`` and ``ur10e`` below DATA and
on ``06-ati-orientation-only`` below WILD, and writes ``docs/studies/payload-real``. The recordings carry no licence, so
they are not part of the repository.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

import bayesid
from tests.studies.page import STUDIES, write_numbers, write_page

#: What the sources say of the wrist's tool: mass [kg], centre of mass [m], offsets [N, N m], by least squares of the same poses.
WRIST = (0.9323, 0.28e-3, 0.05e-3, 43.90e-3)
OFFSET = (-9.0765, 1.0181, -9.9848, -0.43250, 0.69155, 0.15703)
#: Mass on the UR10e's flange [kg].
HUNG = 2.805
REFERENCES = ("before", "feb05-20s-12h", "feb05-20s-8h", "feb06-20s-10h", "feb06-20s-5h")

PAGE = """\
# Payloads on real arms

`python -m tests.studies.payload_real DATA WILD` made this page and [results.json](results.json). The recordings carry
no licence: users fetch them (Zenodo 11075230 and 11096791 for the first wrist, for the second
github.com/leledeyuan00/Gravity-Compensation-F-T-sensor; github.com/shamilmamedov/dynamic_calibration for the UR10e).

## A six-axis sensor in a wrist

24 poses at rest of an ATI Gamma under one tool of 0.932 kg, with no option given. *Known* are the figures of plain least squares
on these poses; a report on the data quotes 0.932 kg.

| | payload | 95 % interval | known |
|---|---|---|---|
{% for r in wrist.quantities -%}
| {{ r.name }} [{{ r.unit }}] | {{ r.value }} | {{ r.low }} to {{ r.high }} | {{ r.known }} |
{% endfor %}

The inertia is not shown: the poses say nothing of it. {{ wrist.inside }} of {{ wrist.quantities | length }} intervals hold the
known figure. Beside it the diagnosis names {{ wrist.effects }}; without that the mass would be {{ wrist.plain }} kg. Against the
0.932 kg `calibrate` finds a common gain of the forces of {{ wrist.gain }} % ± {{ wrist.gain_half }} %. What it could not know:
the sensor's own acceleration in the motions, which contradict the poses and are not averaged in; a common gain of the moments.

## A second wrist, of which only the orientation was recorded

An ATI Axia80 with a gripper; orientations of the hand stand as three revolute joints without links. Its wrench is in the axes of
the base and has the opposite sign. Least squares of one axis of the force at a time gives 1.186 kg (fx), 1.164 kg (fy) and
1.254 kg (fz, whose zero drifts through the rows).

| as | payload [kg] | 95 % interval | said |
|---|---|---|---|
{% for r in second -%}
| {{ r.name }} | {{ r.mass }} | {{ r.interval }} | {{ r.said }} |
{% endfor %}

What it could not know: the drift of fz, since poses carry no time; the two quiet axes decide.

## A UR10e with a body of 2.805 kg

Joint torques from motor currents, with the payload and in five recordings without it. The centre of mass was not published.

| recording without it | mass [kg] | 95 % interval | centre of mass [mm] | log evidence | seconds |
|---|---|---|---|---|---|
{% for r in loaded -%}
| {{ r.reference }} | {{ r.mass }} | {{ r.low }} to {{ r.high }} | {{ r.centre }} | {{ r.evidence }} | {{ r.seconds }} |
{% endfor %}

{{ inside }} of {{ loaded | length }} intervals hold 2.805 kg. Between two recordings without it no mass is shown in {{ quiet }}
of {{ empty | length }} pairs; the largest that could hide is {{ hidden }} kg. What it could not know: drive gains, known
to some two per cent and count in the intervals; the inertia, which these motions do not show.
"""


def wrist(folder: Path) -> dict[str, Any]:
    """The wrist sensor."""
    found, calibrated = bayesid.payload(folder, progress=None), bayesid.calibrate(folder, mass=0.932, progress=None)
    quantities, inside = [], 0
    for q, known in zip((*found.quantities[:4], *found.offset), (*WRIST, *OFFSET), strict=True):
        inside += q.low <= known <= q.high
        quantities.append({"name": q.name, "unit": q.unit, "value": q.value, "low": q.low, "high": q.high, "known": known})
    gain = calibrated.common_gain
    assert gain is not None
    return {
        "quantities": quantities, "inside": inside, "effects": [e.spec for e in found.effects], "plain": found.plain[0].value,
        "gain": 100 * gain.value, "gain_half": 100 * (gain.high - gain.value),
        "inertia_shown": any(q.shown for q in found.inertia),
    }  # fmt: skip


def second(folder: Path) -> list[dict[str, Any]]:
    """The wrist of which only the orientation is known, as recorded and with each mistake undone."""
    out = []
    for name, words in (
        ("as-given", "recorded"),
        ("rotated", "turned into the sensor's axes"),
        ("rotated-negated", "the sign changed, too"),
    ):
        r = bayesid.payload(folder / name, progress=None)
        said = [
            text
            for text in (*r.sentences, *r.warnings)
            if text.startswith(("The mass comes out negative", "Something in the readings"))
        ]
        out.append({
            "name": words, "mass": r.mass.value if r.mass.shown else None, "low": r.mass.low, "high": r.mass.high,
            "shown": r.mass.shown, "said": [text.split(". ")[0].split(": ")[0] for text in said],
        })  # fmt: skip
    return out


def arm(folder: Path) -> dict[str, Any]:
    """The arm: every reference with the loaded recording, and with the next one without a load."""
    loaded, empty = [], []
    for k, name in enumerate(REFERENCES):
        r = bayesid.payload(folder / "after-load", reference=folder / name, progress=None)
        loaded.append({
            "reference": name, "mass": r.mass.value, "low": r.mass.low, "high": r.mass.high, "evidence": r.evidence,
            "centre": (1e3 * r.centre_of_mass).tolist(), "seconds": sum(r.seconds.values()),
        })  # fmt: skip
        other = REFERENCES[(k + 1) % len(REFERENCES)]
        r = bayesid.payload(folder / other, reference=folder / name, progress=None)
        empty.append({"reference": name, "recording": other, "shown": r.mass.shown, "high": r.mass.high})
    return {"loaded": loaded, "empty": empty}


def write(study: dict[str, Any], folder: Path = STUDIES / "payload-real") -> None:
    """Write the page and its numbers."""
    s = write_numbers(study, folder / "results.json", digits=4)
    loaded = [
        {**r, **{k: f"{r[k]:.0f}" for k in ("evidence", "seconds")}, "centre": ", ".join(f"{x:.0f}" for x in r["centre"])}
        for r in s["loaded"]
    ]
    write_page(
        PAGE, folder / "README.md", wrist={**s["wrist"], "effects": ", ".join(s["wrist"]["effects"]) or "nothing"},
        loaded=loaded, empty=s["empty"], inside=sum(r["low"] <= HUNG <= r["high"] for r in s["loaded"]),
        second=[
            {"name": r["name"], "mass": r["mass"] if r["shown"] else "not shown", "said": "; ".join(r["said"]) or "nothing",
             "interval": f"{r['low']} to {r['high']}" if r["shown"] else ""}
            for r in s["second"]
        ],
        quiet=sum(not r["shown"] for r in s["empty"]), hidden=f"{np.max([r['high'] for r in s['empty']]):.2f}",
    )  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--docs", type=Path, default=STUDIES / "payload-real")
    parser.add_argument("wild", type=Path)
    given = parser.parse_args()
    hand = second(given.wild / "06-ati-orientation-only")
    write({"wrist": wrist(given.data / "kuka-med-wrist"), "second": hand, **arm(given.data / "ur10e")}, given.docs)
