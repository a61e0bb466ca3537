"""Public recordings: a server of our own stands for those of their authors."""

from __future__ import annotations

import hashlib
import http.server
import re
import sys
import threading
from functools import partial
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

import bayesid
from bayesid import datasets
from bayesid.cli import main
from bayesid.datasets import DATASETS, Dataset, RemoteFile
from tests.dh_robots import UR10_LINKS, UR10E_LINKS, dh_urdf
from tests.recordings.importing.logs import START, Bag
from tests.simulated import puma2

PAGE = "https://example.org/arm"


class Quiet(http.server.SimpleHTTPRequestHandler):
    """Serves a folder; counts what is asked for."""

    asked: list[str] = []

    def do_GET(self) -> None:
        self.asked.append(self.path)
        super().do_GET()

    def log_message(self, *_) -> None:
        pass


@pytest.fixture
def server(tmp_path, monkeypatch):
    """A folder that is served, and how files in it are called from outside."""
    pytest.importorskip("pooch")
    monkeypatch.delenv("BAYESID_DATA", raising=False)
    folder = tmp_path / "published"
    folder.mkdir()
    monkeypatch.setattr(Quiet, "asked", [])
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(folder))) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        yield folder, f"http://127.0.0.1:{running.server_address[1]}"
        running.shutdown()


def published(server, name: str, data: bytes) -> RemoteFile:
    folder, address = server
    (folder / name).write_bytes(data)
    return RemoteFile(name, f"{address}/{name}", hashlib.sha256(data).hexdigest(), len(data))


def register(monkeypatch, files, make, folder="data/arm") -> None:
    monkeypatch.setitem(DATASETS, "arm", Dataset("arm", "an arm", "MIT", PAGE, "all of it", tuple(files), make, folder))


def motion(joints: int, samples: int = 400) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t = 0.005 * np.arange(samples)
    rate = np.arange(1, joints + 1)
    return t, np.sin(np.outer(t, rate)), np.cos(np.outer(t, rate + 0.5))


@pytest.fixture
def kuka(server, tmp_path, monkeypatch, request):
    """Arrays of the form of the LWR's, and a robot of seven joints."""
    t, q, torques = motion(7)
    files = []
    for name in ("measurements_1", "measurements_3"):
        np.savez(
            tmp_path / f"{name}.npz", times=t[:, None] + 3.0, positions=q, velocities=np.gradient(q, t, axis=0), torques=torques
        )
        files.append(published(server, f"{name}.npz", (tmp_path / f"{name}.npz").read_bytes()))
    text = dh_urdf("lwr", [f"lwr_{k}_joint" for k in range(7)], (*UR10E_LINKS, UR10E_LINKS[1]))
    register(monkeypatch, [*files, published(server, "robot.urdf", text.encode())], datasets.kuka_lwr4)
    return t, q, torques


def test_a_data_set_is_fetched_once_checked_and_read(kuka, tmp_path):
    t, q, torques = kuka
    experiment = bayesid.datasets.load("arm", tmp_path / "cache")
    assert [(m.name, m.role) for m in experiment] == [("measurements_1", "identification"), ("measurements_3", "validation")]
    np.testing.assert_allclose(experiment.motions[0].table.times, t, atol=1e-12)
    np.testing.assert_array_equal(experiment.motions[0].table.positions, q)
    np.testing.assert_array_equal(experiment.motions[1].table.torques, torques)
    assert experiment.inertia_rel_std == 0.3 and experiment.robot.joint_names[0] == "lwr_0_joint"
    assert len(Quiet.asked) == 3
    folder = bayesid.datasets.fetch("arm", tmp_path / "cache")
    assert folder.parent == tmp_path / "cache" / "experiments" and len(Quiet.asked) == 3


def test_a_copy_of_ones_own_is_taken_first(kuka, tmp_path, monkeypatch):
    own = tmp_path / "own" / "data" / "arm"
    bayesid.write_experiment(bayesid.Experiment.from_arrays(puma2(tmp_path), *motion(2)[:2], torques=motion(2)[2]), own)
    monkeypatch.setenv("BAYESID_DATA", str(tmp_path / "own"))
    assert bayesid.datasets.fetch("arm") == own and bayesid.datasets.load("arm").name == "arrays"
    monkeypatch.setitem(sys.modules, "pooch", None)  # is not needed for it
    assert bayesid.datasets.fetch("arm") == own and not Quiet.asked
    monkeypatch.setenv("BAYESID_DATA", str(tmp_path))
    with pytest.raises(
        bayesid.InputError, match=r'arm: fetching it needs pooch; pip install "bayesid\[datasets\]", or put .* data/arm'
    ):
        bayesid.datasets.fetch("arm")


def test_another_file_than_was_published_is_refused(kuka, server, tmp_path):
    (server[0] / "robot.urdf").write_bytes(b"<robot/>")
    with pytest.raises(bayesid.InputError, match="robot.urdf is not what was published: its SHA256 is not") as error:
        bayesid.datasets.fetch("arm", tmp_path / "cache")
    assert PAGE in str(error.value)
    assert not list((tmp_path / "cache").rglob("*robot.urdf")) and not (tmp_path / "cache" / "experiments").exists()


def test_what_cannot_be_had_is_said_in_one_line(kuka, server, tmp_path, monkeypatch):
    (server[0] / "measurements_3.npz").unlink()
    with pytest.raises(
        bayesid.InputError, match="measurements_3.npz cannot be fetched .*404.*connect to the network, or put"
    ) as error:
        bayesid.datasets.fetch("arm", tmp_path / "cache")
    assert "\n" not in str(error.value)
    register(monkeypatch, [RemoteFile("a", "http://127.0.0.1:9/a", 64 * "0", 1)], datasets.kuka_lwr4)
    with pytest.raises(bayesid.InputError, match="127.0.0.1:9/a cannot be fetched"):
        bayesid.datasets.fetch("arm", tmp_path / "cache")
    with pytest.raises(bayesid.InputError, match='amr: no such data set; did you mean "arm"'):
        bayesid.datasets.fetch("amr")
    with pytest.raises(bayesid.InputError, match="kuka-med-wrist: is not fetched; make an experiment folder of what is at https"):
        bayesid.datasets.fetch("kuka-med-wrist")


def test_the_command_lists_and_makes_a_folder(kuka, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert main(["datasets"]) == 0
    said = capsys.readouterr().out
    assert all(f"{name}: {d.summary}" in said and d.licence in said for name, d in DATASETS.items())
    assert main(["datasets", "arm", "--out", str(tmp_path / "mine")]) == 0
    assert f"experiment: {tmp_path / 'mine'}" in capsys.readouterr().out
    assert main(["check", str(tmp_path / "mine"), "--out", str(tmp_path / "checked")]) == 0
    capsys.readouterr()
    assert main(["datasets", "arm", "--out", str(tmp_path / "mine")]) == 2
    assert "is there already" in capsys.readouterr().err
    assert main(["datasets", "amr"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_the_page_lists_every_data_set():
    page = (Path(__file__).parents[1] / "docs" / "howto" / "datasets.md").read_text(encoding="utf-8")
    assert all(f"| `{d.name}` | {d.summary} | {d.licence} |" in page for d in DATASETS.values())
    assert str(DATASETS["ur10"]) in page


def test_the_registry_is_complete():
    """Files of a commit with a checksum, a licence for each, a row of the table for each."""
    table = bayesid.datasets.table()
    assert list(table["name"]) == list(bayesid.datasets.names()) == list(DATASETS) and (table["licence"] != "").all()
    for dataset in DATASETS.values():
        assert (dataset.make is None) == (not dataset.files)
        for file in dataset.files:
            assert len(bytes.fromhex(file.sha256)) == 32 and file.size > 0 and file.url.startswith("https://")
            assert re.search("/[0-9a-f]{40}/", file.url)
        assert len({file.name for file in dataset.files}) == len(dataset.files)


@pytest.mark.parametrize("name", [name for name, d in DATASETS.items()])
def test_own_copies_are_what_the_registry_says(name, shared, monkeypatch):
    """Those who have the recordings by hand get them by name, with as many joints and readings as the recipe makes."""
    shared(f"{DATASETS[name].folder}/experiment.toml")
    monkeypatch.setenv("BAYESID_DATA", str(shared(".")))
    experiment = bayesid.datasets.load(name)
    assert experiment.robot.n == {"kuka-lwr4": 7, "med7": 7, "kuka-med-wrist": 3}.get(name, 6)


def test_the_med7s_sign_is_turned(tmp_path):
    t, q, torques = motion(7, 100)
    head = ",".join(f"{kind}_{k}" for kind in ("q", "tau") for k in range(7))
    np.savetxt(tmp_path / "m.csv", np.hstack([q, torques]), delimiter=",", header=head, comments="")
    (tmp_path / "robot.urdf").write_text(dh_urdf("m", [f"A{k}" for k in range(1, 8)], (*UR10E_LINKS, UR10E_LINKS[1])))
    made = datasets.med7({"measurements.csv": tmp_path / "m.csv", "robot.urdf": tmp_path / "robot.urdf"})
    np.testing.assert_allclose(made["validation"].table.torques, -torques[70:])
    np.testing.assert_allclose(made["validation"].table.times, 0.01 * np.arange(70, 100))
    np.testing.assert_allclose(made["identification"].table.positions, q[:70])


def test_motors_of_the_tx40_are_joints_over_gears(tmp_path):
    """Each joint's power is its motor's: what a torque does over a motion stays the same."""
    t, q, torques = motion(6, 40_000)
    ratio = np.array([32, 32, 45, -48, 45, 32])
    for name, values in (("positions", q), ("torques", torques)):
        np.savetxt(tmp_path / f"{name}.csv", values, delimiter=",", header="a", comments="")
    (tmp_path / "robot.urdf").write_text(dh_urdf("t", [f"joint_{k}" for k in range(1, 7)], UR10E_LINKS))
    made = datasets.tx40({name: tmp_path / name for name in ("robot.urdf", "positions.csv", "torques.csv")})
    table = made["identification"].table
    np.testing.assert_allclose(np.diff(table.times), 0.002)
    turned = table.positions - np.array([0, -np.pi / 2, np.pi / 2, 0, 0, 0])
    np.testing.assert_allclose(turned * ratio, q[:22_000].reshape(-1, 10, 6).mean(axis=1), atol=1e-12)
    np.testing.assert_allclose(table.torques / ratio, torques[:22_000].reshape(-1, 10, 6).mean(axis=1), atol=1e-12)
    assert made["validation"].table.times[-1] == pytest.approx(7.5989)


def test_robots_in_the_package_are_those_of_the_makers_tables():
    made = {"ur10": ([f"joint{k}" for k in range(1, 7)], UR10_LINKS), "ur10e": (datasets.UR_JOINTS, UR10E_LINKS)}
    for name, (joints, links) in made.items():
        assert files("bayesid.robot").joinpath(f"{name}.urdf").read_text(encoding="utf-8") == dh_urdf(name, joints, links)


def test_a_bag_of_the_ur10_is_read_by_joint_names(tmp_path):
    t, q, torques = motion(6, 500)
    order, rates = [2, 1, 0, 3, 4, 5], np.gradient(q, t, axis=0)  # drivers list the elbow first
    names = [datasets.UR_JOINTS[k] for k in order]
    with Bag(tmp_path / "ur10.db3", "sqlite3") as bag:
        for row, ns in enumerate(START + np.round(t * 1e9).astype(int)):
            bag.joints(ns, names, q[row, order], v=rates[row, order], tau=torques[row, order], log=ns)
    made = datasets.ur10({"ur10.db3": next((tmp_path / "ur10.db3").glob("*.db3"), tmp_path / "ur10.db3")})
    np.testing.assert_allclose(np.vstack([m.table.positions for m in made]), q, atol=1e-12)
    assert [m.role for m in made] == ["identification", "validation"] and made.inertia_rel_std == 1.0
    assert len(made.motions[0].table) == pytest.approx(300, abs=2)
