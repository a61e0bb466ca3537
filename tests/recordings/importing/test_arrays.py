"""NumPy archives, MAT files, HDF5, LeRobot data sets and MuJoCo's time series, written by numpy, scipy, h5py and pyarrow."""

from __future__ import annotations

import json
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io

import bayesid
from bayesid.errors import InputError
from bayesid.recordings.table import Table
from tests.recordings.importing.logs import JOINTS, START, Known, make_known


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Known:
    return make_known(tmp_path_factory.mktemp("known"))


def arrays(known: Known) -> dict[str, np.ndarray]:
    return {"t": known.t, "q": known.q, "qd": known.v, "tau": known.tau, "ft": known.wrench}


def write_npz(path: Path, known: Known) -> None:
    np.savez(path, **arrays(known), label=np.array("run 1"), gain=np.array(2.0))


def write_transposed_npz(path: Path, known: Known) -> None:
    """Samples along the second axis, as many write them."""
    np.savez(path, **{name: values.T for name, values in arrays(known).items()})


def write_mat(path: Path, known: Known) -> None:
    """MATLAB's usual: a structure of matrices, times as a column."""
    log = {name: values.reshape(len(values), -1) for name, values in arrays(known).items()}
    scipy.io.savemat(path, {"log": log, "comment": "run 1", "rate": 125.0, "names": np.array(["a", "b"], dtype=object)})


def write_mat73(path: Path, known: Known) -> None:
    """As MATLAB's ``save -v7.3`` does: HDF5, columns first, with the class of each array, and strings as numbers."""
    with h5py.File(path, "w", userblock_size=512) as file:
        log = file.create_group("log")
        log.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in arrays(known).items():
            log.create_dataset(name, data=values.reshape(len(values), -1).T).attrs["MATLAB_class"] = np.bytes_("double")
        text = log.create_dataset("comment", data=np.array([[114], [117], [110]], np.uint16))
        text.attrs["MATLAB_class"] = np.bytes_("char")
        file.create_dataset("#refs#/a", data=np.zeros(1000))
    with path.open("r+b") as handle:
        handle.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x02IM")


def write_hdf5(path: Path, known: Known) -> None:
    with h5py.File(path, "w") as file:
        for name, values in arrays(known).items():
            file.create_dataset(f"arm/{name}", data=values, compression="gzip")


def write_records(path: Path, known: Known) -> None:
    """One array with fields."""
    records = np.zeros(len(known.t), dtype=[(name, float, values.shape[1:]) for name, values in arrays(known).items()])
    for name, values in arrays(known).items():
        records[name] = values
    np.save(path, records)


WRITERS: dict[str, tuple[str, Callable[[Path, Known], None]]] = {
    "npz": ("log.npz", write_npz), "npz, samples last": ("log.npz", write_transposed_npz),
    "npy with fields": ("log.npy", write_records), "mat": ("log.mat", write_mat),
    "mat 7.3": ("log.mat", write_mat73), "hdf5": ("log.h5", write_hdf5),
}  # fmt: skip


def holds(table: Table, known: Known) -> None:
    for name, values in (("times", known.t), ("positions", known.q), ("velocities", known.v), ("torques", known.tau)):
        np.testing.assert_array_equal(getattr(table, name), values)
    np.testing.assert_array_equal(table.wrench, known.wrench)


@pytest.mark.parametrize("kind", WRITERS)
def test_arrays_are_read_as_they_were_written(kind, known, tmp_path):
    name, write = WRITERS[kind]
    write(tmp_path / name, known)
    imported = bayesid.read_recording(tmp_path / name, known.urdf, joints=JOINTS, sensor="wrist_ft")
    holds(imported.experiment.motions[0].table, known)


def test_objects_of_matlab_are_told_as_such(known, tmp_path):
    """A timeseries in a MAT file is a reference of six numbers, which was offered as a column."""

    def write(**arrays: np.ndarray) -> Path:
        with h5py.File(tmp_path / "log.mat", "w") as file:
            log = file.create_dataset("log", data=np.array([[0xDD000000, 2, 1, 1, 1, 1]], np.uint32))
            log.attrs["MATLAB_class"], log.attrs["MATLAB_object_decode"] = np.bytes_("timeseries"), 3
            for name, values in arrays.items():
                file.create_dataset(name, data=values.T).attrs["MATLAB_class"] = np.bytes_("double")
        return tmp_path / "log.mat"

    with pytest.raises(InputError, match=r"no arrays of samples; it holds log \(timeseries\); .* save x.Time and x.Data"):
        bayesid.read_recording(write(), known.urdf, joints=JOINTS)
    imported = bayesid.read_recording(write(t=known.t[:, None], q=known.q, tau=known.tau), known.urdf, joints=JOINTS)
    assert imported.recordings[0].recording.left_over == ("log (timeseries)",)


@pytest.mark.parametrize("kind", WRITERS)
def test_cut_off_and_damaged_files_end_in_one_line(kind, known, tmp_path):
    name, write = WRITERS[kind]
    write(tmp_path / name, known)
    whole, rng, refused = (tmp_path / name).read_bytes(), np.random.default_rng(2), 0
    for k in range(20):
        content = bytearray(whole[: int(len(whole) * rng.uniform(0.0, 0.98))] if k % 2 else whole)
        if not k % 2:
            for at in rng.integers(min(len(content), 4000), size=30):
                content[at] = rng.integers(256)
        (tmp_path / name).write_bytes(content)
        try:
            bayesid.read_recording(tmp_path / name, known.urdf, joints=JOINTS, sensor="wrist_ft")
        except InputError as error:
            refused += 1
            assert "\n" not in str(error) and len(str(error)) < 600
    assert refused >= 10


def test_parts_of_arrays_are_stated(known, tmp_path):
    """One matrix of everything, as a simulation writes its state."""
    state = np.column_stack([known.q, known.v, known.tau, known.wrench])
    np.savez(tmp_path / "log.npz", time=known.t, state=state)
    columns = {"q": "state[0:2]", "v": "state[2:4]", "tau": "state[4:6]", "wrench": "state[6:12]"}
    imported = bayesid.read_recording(tmp_path / "log.npz", known.urdf, joints=JOINTS, sensor="wrist_ft", columns=columns)
    holds(imported.experiment.motions[0].table, known)
    with pytest.raises(InputError, match=r'columns wrench: no column "state\[12\]"'):
        bayesid.read_recording(tmp_path / "log.npz", known.urdf, joints=JOINTS, columns=columns | {"wrench": "state[7:13]"})


def test_a_word_that_ends_as_a_wrench_is_called_is_none(known, tmp_path):
    """An array "left" of six numbers beside the wrench."""
    np.savez(tmp_path / "log.npz", **arrays(known), left=np.zeros_like(known.wrench))
    imported = bayesid.read_recording(tmp_path / "log.npz", known.urdf, joints=JOINTS, sensor="wrist_ft")
    holds(imported.experiment.motions[0].table, known)
    assert imported.recordings[0].recording.left_over == tuple(f"left[{k}]" for k in range(6))


def test_arrays_of_two_lengths_have_times_of_their_own(known, tmp_path):
    np.savez(tmp_path / "log.npz", t=known.t, q=known.q, tau=known.tau, wrench_time=known.t[::5], wrench=known.wrench[::5])
    options = dict(joints=JOINTS, sensor="wrist_ft")
    with pytest.raises(InputError, match="no column of times is found"):
        bayesid.read_recording(tmp_path / "log.npz", known.urdf, **options)
    imported = bayesid.read_recording(tmp_path / "log.npz", known.urdf, columns={"t": ["t", "wrench_time"]}, **options)
    table = imported.experiment.motions[0].table
    np.testing.assert_array_equal(table.wrench, known.wrench[::5])
    np.testing.assert_allclose(table.positions, known.q[::5], rtol=0.0, atol=1e-12)


def test_a_time_series_of_mujoco_is_read_by_its_mapping(known, tmp_path):
    """The layout of ``TimeSeries.save_to_disk`` of MuJoCo 4.0: indices into the state, kinds as numbers, JSON in an array."""
    data = np.column_stack([known.q, known.v, known.tau])
    mapping = {
        "shoulder_qpos": [2, [0]], "elbow_qpos": [2, [1]], "shoulder_qvel": [3, [2]], "elbow_qvel": [3, [3]],
        "drives": [0, [4, 5]],
    }  # fmt: skip
    np.savez(tmp_path / "run.npz", times=known.t, data=data, signal_mapping=np.asarray(json.dumps(mapping)))
    imported = bayesid.read_recording(tmp_path / "run.npz", known.urdf, joints=JOINTS, columns={"tau": "drives"})
    table = imported.experiment.motions[0].table
    for name, values in (("times", known.t), ("positions", known.q), ("velocities", known.v), ("torques", known.tau)):
        np.testing.assert_array_equal(getattr(table, name), values)
    np.savez(tmp_path / "run.npz", times=known.t, data=data, signal_mapping=np.asarray('{"a": [2, [99]]}'))
    with pytest.raises(InputError, match="cannot be read as a TimeSeries of MuJoCo"):
        bayesid.read_recording(tmp_path / "run.npz", known.urdf)


def test_an_array_is_offered_whole_where_a_quantity_is_misspelt(known, tmp_path):
    scipy.io.savemat(tmp_path / "run.mat", {"rec": {"time": known.t, "act_pos_rad": known.q, "act_torque_nm": known.tau}})
    for key, name, meant in (("q", "rec.act_pos_rad", "rec/act_pos_rad[0:2]"), ("q1", "rec/act_pos_rad[2]", "rec/act_pos_rad[")):
        with pytest.raises(InputError, match=re.escape(f'no column "{name}"; did you mean "{meant}')):
            bayesid.read_recording(tmp_path / "run.mat", known.urdf, joints=JOINTS, columns={key: name})


def test_pickled_arrays_and_archives_of_any_size_are_not_loaded(known, tmp_path):
    np.savez(tmp_path / "log.npz", t=known.t, q=np.array([{"run": "anything"}], dtype=object))
    with pytest.raises(InputError, match="no positions"):
        bayesid.read_recording(tmp_path / "log.npz", known.urdf)
    np.savez(tmp_path / "bare.npz", gain=np.array(1.0))
    with pytest.raises(InputError, match="holds no arrays of samples; it holds gain"):
        bayesid.read_recording(tmp_path / "bare.npz", known.urdf)
    header = np.lib.format
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive, archive.open("q.npy", "w") as entry:
        header.write_array_header_1_0(entry, {"shape": (1 << 50,), "fortran_order": False, "descr": "<f8"})
        entry.write(bytes(1000))
    with pytest.raises(InputError, match="bomb.npz"):
        bayesid.read_recording(tmp_path / "bomb.npz", known.urdf)


def write_lerobot(folder: Path, known: Known, episodes: int = 3, version: str = "v3.0", names: Any = None) -> Path:
    """A data set of version 3: episodes one after the other in files of chunks, state and action as lists."""
    rows = len(known.t) // episodes
    tables = []
    for episode in range(episodes):
        part = slice(episode * rows, (episode + 1) * rows)
        state = np.column_stack([known.q[part] * 180.0 / np.pi, known.tau[part]])
        tables.append(
            pa.table(
                {
                    "observation.state": pa.FixedSizeListArray.from_arrays(pa.array(state.ravel()), state.shape[1]),
                    "action": pa.FixedSizeListArray.from_arrays(pa.array((known.q[part] * 180.0 / np.pi).ravel()), 2),
                    "timestamp": pa.array(known.t[:rows]), "frame_index": pa.array(np.arange(rows)),
                    "episode_index": pa.array(np.full(rows, episode)),
                }
            )
        )  # fmt: skip
    (folder / "meta").mkdir(parents=True)
    (folder / "data" / "chunk-000").mkdir(parents=True)
    pq.write_table(pa.concat_tables(tables[:2]), folder / "data" / "chunk-000" / "file-000.parquet")
    pq.write_table(pa.concat_tables(tables[2:]), folder / "data" / "chunk-000" / "file-001.parquet")
    features = {
        "observation.state": {"dtype": "float32", "shape": [4], "names": names},
        "action": {"dtype": "float32", "shape": [2], "names": ["shoulder.pos", "elbow.pos"]},
    }
    (folder / "meta" / "info.json").write_text(json.dumps({"codebase_version": version, "fps": 125, "features": features}))
    return folder


def test_a_data_set_of_lerobot_is_a_recording_an_episode(known, tmp_path):
    named = write_lerobot(tmp_path / "named", known, names=["shoulder.pos", "elbow.pos", "shoulder.effort", "elbow.effort"])
    imported = bayesid.read_recording(named, known.urdf, units={"q": "deg", "qr": "deg"})
    assert [(m.name, m.role) for m in imported.experiment.motions] == [
        ("named_0", "identification"), ("named_1", "identification"), ("named_2", "validation"),
    ]  # fmt: skip
    rows = len(known.t) // 3
    for episode, motion in enumerate(imported.experiment.motions):
        part = slice(episode * rows, (episode + 1) * rows)
        np.testing.assert_allclose(motion.table.positions, known.q[part], rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(motion.table.commanded, known.q[part], rtol=1e-13, atol=1e-13)
        np.testing.assert_array_equal(motion.table.torques, known.tau[part])
    plain = write_lerobot(tmp_path / "plain", known)
    columns = {"q": "observation.state[0:2]", "tau": "observation.state[2:4]"}
    options = dict(joints=JOINTS, columns=columns, units={"q": "deg"}, episodes=[2])
    (motion,) = bayesid.read_recording(plain, known.urdf, **options).experiment.motions
    np.testing.assert_array_equal(motion.table.torques, known.tau[2 * rows : 3 * rows])
    with pytest.raises(InputError, match="no episode 7; there are 0, 1, 2"):
        bayesid.read_recording(plain, known.urdf, **options | {"episodes": [7]})


def test_data_sets_that_are_of_another_version_or_damaged_are_refused(known, tmp_path):
    with pytest.raises(InputError, match='codebase_version: "v2.1" is not version 3'):
        bayesid.read_recording(write_lerobot(tmp_path / "old", known, version="v2.1"), known.urdf)
    folder = write_lerobot(tmp_path / "cut", known)
    file = folder / "data" / "chunk-000" / "file-001.parquet"
    file.write_bytes(file.read_bytes()[:500])
    with pytest.raises(InputError, match="file-001.parquet: cannot be read as Parquet"):
        bayesid.read_recording(folder, known.urdf)
    (folder / "meta" / "info.json").write_text("{")
    with pytest.raises(InputError, match="cut/meta/info.json: cannot be read"):
        bayesid.read_recording(folder, known.urdf)


def test_a_refusal_names_what_may_be_meant_first(known, tmp_path):
    """Of many matrices those of as many columns as joints, called positions before others, as `columns` takes them."""
    n = len(known.t)
    log = {f"ctrl/state{k}": np.zeros((n, 5)) for k in range(15)} | {f"ctrl/err{k}": np.zeros(n) for k in range(15)}
    log |= {"para/gains": np.zeros(7), "rec/kept": known.tau, "rec/act_pos_rad": known.q, "clock": known.t}
    nested: dict[str, dict[str, np.ndarray]] = {}
    for name, values in log.items():
        group, _, field = name.rpartition("/")
        nested.setdefault(group or "clock", {})[field] = values
    scipy.io.savemat(tmp_path / "log.mat", nested)
    with pytest.raises(InputError, match=r"its columns are: rec/act_pos_rad\[0:2\], rec/kept\[0:2\], ctrl/state0\[0:5\]") as said:
        bayesid.read_recording(tmp_path / "log.mat", known.urdf, joints=JOINTS)
    assert str(said.value).endswith("and 6 more") and "such as q=rec/act_pos_rad[0:2])" in str(said.value)
    columns = {"t": "clock/clock", "q": "rec/act_pos_rad[0:2]", "tau": "rec/kept[0:2]"}
    table = bayesid.read_recording(tmp_path / "log.mat", known.urdf, joints=JOINTS, columns=columns).experiment.motions[0].table
    np.testing.assert_array_equal(table.positions, known.q)


#: Times as arrays of kinds whose arithmetic is not that of floats: whole numbers without a sign, which lack what is below zero,
#: short floats, texts, and durations.
TIMES = {
    "t uint64": lambda known: (START + 200 + known.ns).astype(np.uint64),  # nearest float: 56 ns later
    "t_ms float32": lambda known: (1e6 + known.t * 1e3).astype(np.float32),
    "t texts": lambda known: known.t.astype(str),
    "t m8": lambda known: known.ns.astype("m8[ns]"),
}


@pytest.mark.parametrize("kind", TIMES)
def test_times_of_other_kinds_of_numbers_are_exact(kind, known, tmp_path):
    times = TIMES[kind](known)
    np.savez(tmp_path / "log.npz", **{kind.split()[0]: times}, q=known.q, tau=known.tau)
    table = bayesid.read_recording(tmp_path / "log.npz", known.urdf, joints=JOINTS).experiment.motions[0].table
    np.testing.assert_allclose(table.times - table.times[0], known.t, rtol=0.0, atol=1e-9)
    if kind == "t m8":
        frame = pd.DataFrame({"t": pd.to_timedelta(times), "q": list(known.q), "tau": list(known.tau)})
        frame.to_parquet(tmp_path / "log.parquet")
        again = bayesid.read_recording(tmp_path / "log.parquet", known.urdf, joints=JOINTS).experiment.motions[0].table
        np.testing.assert_array_equal(again.times, table.times)


def test_a_table_in_hdf5_is_read_by_its_fields(known, tmp_path):
    rows = np.rec.fromarrays([known.t, *known.q.T, *known.tau.T], names="t,q1,q2,tau1,tau2")
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["run/samples"] = rows
    table = bayesid.read_recording(tmp_path / "log.h5", known.urdf, joints=JOINTS).experiment.motions[0].table
    np.testing.assert_array_equal(table.positions, known.q)
    np.testing.assert_array_equal(table.torques, known.tau)


@pytest.mark.parametrize("kind", ["structures", "cells"])
def test_arrays_of_structures_and_cells_of_matlab_are_read_by_their_numbers(kind, known, tmp_path):
    """Simulink's "structure with time" has an array of signals, one a port."""
    if kind == "structures":
        signals = np.zeros(2, dtype=[("values", object), ("dimensions", object), ("label", object)])
        signals[0], signals[1] = (known.q, 2.0, "angles"), (known.tau, 2.0, "moments")
        scipy.io.savemat(tmp_path / "log.mat", {"out": {"time": known.t, "signals": signals}})
        columns = {"q": "out/signals(1)/values", "tau": "out/signals(2)/values"}
    else:
        cells = np.empty(2, object)
        cells[:] = [known.q, known.tau]
        scipy.io.savemat(tmp_path / "log.mat", {"t": known.t, "data": cells})
        columns = {"q": "data(1)", "tau": "data(2)"}
    made = bayesid.read_recording(tmp_path / "log.mat", known.urdf, joints=JOINTS, columns=columns)
    np.testing.assert_array_equal(made.experiment.motions[0].table.positions, known.q)
    np.testing.assert_array_equal(made.experiment.motions[0].table.torques, known.tau)


@pytest.mark.parametrize("hole", [None, [None, 1.0], [np.nan, 1.0]], ids=["row", "entry", "nan"])
def test_a_list_without_a_number_is_a_row_without_a_reading(hole, known, tmp_path):
    """pandas writes NaN in lists as an entry that is absent; a column with one was passed over."""
    frame = pd.DataFrame({"t": known.t, "q": list(known.q), "tau": list(known.tau)})
    frame.at[7, "tau"] = hole
    frame.to_parquet(tmp_path / "log.parquet")
    table = bayesid.read_recording(tmp_path / "log.parquet", known.urdf, joints=JOINTS).experiment.motions[0].table
    np.testing.assert_array_equal(table.torques, np.delete(known.tau, 7, axis=0))


def test_structures_within_structures_are_read_by_the_path(known, tmp_path):
    """Messages of ROS as rows: a header with a stamp stands beside what is read, and ended the import."""
    stamps = [{"stamp": {"sec": int(ns) // 10**9, "nanosec": int(ns) % 10**9}, "frame_id": "tool"} for ns in known.ns]
    joints = [
        {name: {"position": q[k], "effort": tau[k]} for k, name in enumerate(JOINTS)}
        for q, tau in zip(known.q.tolist(), known.tau.tolist(), strict=True)
    ]
    table = pa.table({"t": known.t, "header": pa.array(stamps), "joint_states": pa.array(joints)})
    pq.write_table(table, tmp_path / "log.parquet", row_group_size=300)
    imported = bayesid.read_recording(tmp_path / "log.parquet", known.urdf, joints=JOINTS)
    np.testing.assert_array_equal(imported.experiment.motions[0].table.torques, known.tau)
    assert "header/stamp" in imported.recordings[0].recording.left_over
