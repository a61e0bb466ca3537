"""python tests/benchmarks/diagnosis.py [--write]: how long `diagnose` takes on 40 s of a six-joint arm.

The example PUMA 560, wrench and torques in turn, two motions of 20 s and one of 12 s for validation, one hidden effect each.
``--write`` renews docs/studies/diagnosis-speed.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

import bayesid
from bayesid.robot.robot import load_robot

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.example_robots import puma560_urdf
from tests.studies.page import STUDIES, write_page

PAGE = """\
# How long a diagnosis takes

The example PUMA 560, six joints: two motions of 20 s to fit and one of 12 s for validation, encoder counts of 2e-5 rad, one
hidden effect each. Median {{ median_s }} s, at most {{ largest_s }} s, on {{ cpus }} cores; all of them take {{ processor_s }} s
of processor time. This page is made by `python tests/benchmarks/diagnosis.py --write`. How often it names correctly:
[blind naming](../../../case_studies/blind_naming/README.md).

| channel | hidden | named | seconds | of processor time |
|---|---|---|---|---|
{% for c in cases %}
| {{ c.channel }} | {{ c.hidden | join or "nothing" }} | {{ c.named | join(", ") }} | {{ c.seconds }} | {{ c.used }} |
{% endfor %}

Flexible joints and compliant bases take longest, because their noise is estimated again for every compliance tried: on seven
joints, or beside a second effect, up to two minutes.
"""
HIDDEN = (
    ("wrench", ()), ("wrench", ("sensor_gain@mx",)), ("wrench", ("tether@joint3",)), ("wrench", ("base_tilt",)),
    ("wrench", ("encoder_offset@joint2",)), ("torque", ()), ("torque", ("viscous_friction@joint2",)),
    ("torque", ("torque_ripple@joint3",)), ("torque", ("payload@joint3",)),
    ("both", ("sensor_delay",)), ("both", ("joint_flexibility@joint2",)),
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    cases = []
    with tempfile.TemporaryDirectory() as folder:
        (path := Path(folder) / "puma560.urdf").write_text(puma560_urdf(), encoding="utf-8")
        robot = load_robot(path)
        motions = [
            bayesid.fourier_trajectory(robot, name, role, duration=duration, seed=seed)
            for seed, (name, role, duration) in enumerate(
                [("first", "identification", 20.0), ("second", "identification", 20.0), ("unseen", "validation", 12.0)]
            )
        ]
        for channel, effects in HIDDEN:
            recorder = bayesid.Recorder(force_std=0.2, torque_std=0.02, resolution=2e-5)
            recorded = bayesid.simulate(robot, motions, effects=effects, recorder=recorder, perturb=0.02, seed=1)
            if not cases:  # compiled functions are loaded once
                bayesid.diagnose(recorded, channel)
            since = time.process_time()
            found = bayesid.diagnose(recorded, channel)
            used = time.process_time() - since
            names = [f.term.effect.spec for f in found.found]
            cases.append({
                "channel": channel, "hidden": list(effects), "named": names, "seconds": round(found.seconds, 1),
                "used": round(used, 1),
            })  # fmt: skip
            print(json.dumps(cases[-1]), flush=True)
    seconds = [c["seconds"] for c in cases]
    result = {
        "cpus": os.cpu_count(), "median_s": statistics.median(seconds), "largest_s": max(seconds),
        "processor_s": round(sum(c["used"] for c in cases), 1), "cases": cases,
    }  # fmt: skip
    print(f"median {result['median_s']:.1f} s on {result['cpus']} cores")
    if options.write:
        (STUDIES / "diagnosis-speed" / "results.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        write_page(PAGE, STUDIES / "diagnosis-speed" / "README.md", **result)


if __name__ == "__main__":
    main()
