"""A real arm, a real payload: folders against those prepared before, the page against its numbers, what the page claims."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

import bayesid
from bayesid import datasets
from tests.dh_robots import UR10E_LINKS, dh_urdf

STUDY = Path(__file__).parents[2] / "case_studies" / "real_payload"
MODULES = ("run", "present", "arm")
CLONE = "BAYESID_UR10E_CLONE"


@pytest.fixture(scope="module")
def arm(study):
    return sys.modules["arm"]


@pytest.fixture(scope="module")
def results():
    return json.loads((STUDY / "results.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def clone(arm):
    folder = os.environ.get(CLONE)
    if not folder:
        pytest.skip(f"set {CLONE} to a clone of github.com/shamilmamedov/dynamic_calibration")
    assert arm.is_clone(Path(folder))
    return Path(folder)


def test_page_is_that_of_the_results(study, results):
    page = (STUDY / "README.md").read_text(encoding="utf-8")
    assert study.fill(page, study.tables(results)) == page
    for name in ("torques", "closed", "watch"):
        assert f"({name}.png)" in page and (STUDY / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_what_the_page_claims(results):
    changed, recordings = results["changed"], results["series"]["recordings"]
    assert changed["verdict"] == "named" and changed["effects"] == ["payload@joint6"]
    assert changed["alone"]["verdict"] == "named_in_part" and "payload@joint6" not in changed["alone"]["effects"]
    for w in recordings:
        assert w["effects"] == (["payload@joint6"] if w["loaded"] else []), w["name"]
        if w["loaded"]:
            assert abs(w["payload"]["mass"] - 2.805) < min(0.15, w["payload"]["half"])
    assert sum(not w["loaded"] for w in recordings) >= 4
    rms = changed["curves"]["rms"]
    assert all(after < before for before, after in zip(rms["before"], rms["after"], strict=True))
    error, apart = results["used"]["error"], results["used"]["apart"]
    assert error["with"] < error["without"] and apart["with"] < apart["without"]


def test_robot_is_that_of_the_maker(arm, shared, tmp_path):
    """The URDF made of tables of Denavit-Hartenberg parameters beside one prepared earlier."""
    (tmp_path / "robot.urdf").write_text(dh_urdf("ur10e", datasets.UR_JOINTS, UR10E_LINKS), encoding="utf-8")
    ours, theirs = (bayesid.load_robot(p) for p in (tmp_path / "robot.urdf", shared("data/ur10e/before/robot.urdf")))
    np.testing.assert_allclose(ours.nominal, theirs.nominal, atol=1e-9)
    assert ours.joint_names == theirs.joint_names


def test_ready_folders_become_experiments(arm, shared, tmp_path):
    ready = shared("data/ur10e")
    names = [r.name for r in arm.prepare(ready, tmp_path)]
    assert names == [r.name for r in arm.SERIES if r.ready]
    made, given = (bayesid.load_experiment(f).motions[0].table for f in (tmp_path / "after", ready / "after-load"))
    np.testing.assert_allclose(made.positions, given.positions, atol=1e-9)
    assert made.torques is not None and given.torques is not None
    np.testing.assert_allclose(made.torques, given.torques, atol=1e-9)
    assert [m.role for m in bayesid.load_experiment(tmp_path / "arm").motions] == ["identification", "validation"]
    with pytest.raises(FileNotFoundError, match="neither a clone"):
        arm.prepare(tmp_path, tmp_path / "other")


def written(arm, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """A clone with one recording, its samples at uneven times; times and a smooth course of all readings (k, 12)."""
    times = 100.0 + np.cumsum(np.random.default_rng(0).choice([0.010, 0.012], 1500))
    raw = np.zeros((len(times), 31))
    since = times - times[0]
    course = np.sin(np.outer(np.clip(since - 3.0, 0.0, 8.0), np.arange(1, 13) * np.pi / 8.0))
    raw[:, 0], raw[:, 1:7], raw[:, 13:19] = times, course[:, :6], course[:, 6:]
    raw[:, 7:13] = np.where((since > 3.0) & (since < 11.0), 0.5, 0.0)[:, None]
    path = folder / arm.RAW / arm.BEFORE.file
    path.parent.mkdir(parents=True)
    np.savetxt(path, raw, fmt="%.4f", delimiter=",")
    return since, course


def test_a_raw_file_becomes_a_table(arm, tmp_path):
    """Even times, the moving part and a margin, currents times gains."""
    since, course = written(arm, tmp_path)
    table = arm.table(tmp_path, arm.BEFORE)
    np.testing.assert_allclose(np.diff(table[:, 0]), 0.01, atol=1e-9)
    assert table[0, 0] == pytest.approx(2.7, abs=0.02) and table[-1, 0] == pytest.approx(11.3, abs=0.02)
    inner = (table[:, 0] > 3.1) & (table[:, 0] < 10.9)  # away from corners of the course
    expected = np.sin(np.outer(table[inner, 0] - 3.0, np.arange(1, 13) * np.pi / 8.0))
    gains = np.concatenate([np.ones(6), datasets.UR10E_GAINS])
    np.testing.assert_allclose(table[inner, 1:], expected * gains, atol=2e-3)


def test_raw_recordings_are_those_prepared_before(arm, clone, shared):
    """All six recordings that are there in both forms, to the decimals of the tables."""
    ready = shared("data/ur10e")
    both = [r for r in (arm.BEFORE, *arm.SERIES) if r.ready]
    assert len(both) == 6
    for recording in both:
        ours, theirs = arm.table(clone, recording), arm.table(ready, recording)
        np.testing.assert_allclose(ours[:, 0], theirs[:, 0], atol=1e-6)
        np.testing.assert_allclose(ours[:, 1:7], theirs[:, 1:7], atol=5.01e-6)
        np.testing.assert_allclose(ours[:, 7:], theirs[:, 7:], atol=5.01e-5)


def test_drive_gains_are_the_controller_s(arm, clone):
    """Desired torque over desired current of joints 2 to 4, at standstill before the arm moves."""
    top, below = np.zeros(6), np.zeros(6)
    for recording in (arm.BEFORE, *arm.SERIES):
        raw = np.loadtxt(clone / arm.RAW / recording.file, delimiter=",")
        moving = int(np.argmax(np.abs(raw[:, 7:13]).max(axis=1) > datasets.UR10E_MOVING))
        current, torque = raw[: max(moving - 30, 0), 19:25], raw[: max(moving - 30, 0), 25:31]
        top += np.sum(current * torque, axis=0)
        below += np.sum(current**2, axis=0)
    np.testing.assert_allclose(top[1:4] / below[1:4], datasets.UR10E_GAINS[1:4], rtol=2e-3)
