"""Texts as other tools write tables: what separates cells, what decimals are written with, and what stands above the names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayesid
from bayesid.errors import InputError
from tests.recordings.importing.logs import JOINTS, Known, make_known

NAMES = ["t", "q1", "q2", "tau1", "tau2"]


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Known:
    return make_known(tmp_path_factory.mktemp("known"), duration=2.0)


def frame(known: Known) -> pd.DataFrame:
    return pd.DataFrame(np.column_stack([known.t, known.q, known.tau]), columns=NAMES)


def csv(**options) -> Callable[[Path, pd.DataFrame], object]:
    return lambda path, frame: frame.to_csv(path, index=False, **options)


def numpy(**options) -> Callable[[Path, pd.DataFrame], object]:
    return lambda path, frame: np.savetxt(path, frame.to_numpy(), **options)


def above(text: str, **options) -> Callable[[Path, pd.DataFrame], object]:
    return lambda path, frame: path.write_text(text + frame.to_csv(index=False, **options), encoding="utf-8")


#: By what is written: the writer, and how exact numbers are in the text.
TEXTS = {
    "tabs and decimal commas": (csv(sep="\t", decimal=","), 0.0),
    "bars and decimal commas": (csv(sep="|", decimal=","), 0.0),
    "semicolons and decimal points": (csv(sep=";"), 0.0),
    "quoted decimal commas": (csv(sep=";", decimal=",", quoting=1), 0.0),
    "blanks, as savetxt has it": (numpy(header=" ".join(NAMES)), 0.0),
    "blanks, and a header without a mark": (numpy(header=" ".join(NAMES), comments=""), 0.0),
    "columns of one width": (lambda path, frame: path.write_text(frame.to_string(index=False)), 1e-6),
    "blanks and decimal commas": (csv(sep=" ", decimal=","), 0.0),
    "the separator first, for Excel": (above("sep=;\n", sep=";", decimal=","), 0.0),
    "a remark of MATLAB's": (above("% made by hand\n% "), 0.0),
}


@pytest.mark.parametrize("case", TEXTS)
def test_a_table_is_read_as_it_was_written(case, known, tmp_path):
    write, rounding = TEXTS[case]
    write(tmp_path / "log.txt", frame(known))
    table = bayesid.read_recording(tmp_path / "log.txt", known.urdf, joints=JOINTS).experiment.motions[0].table
    for name, values in (("times", known.t), ("positions", known.q), ("torques", known.tau)):
        np.testing.assert_allclose(getattr(table, name), values, rtol=0.0, atol=rounding)


#: A matrix of numbers as it is written without names.
MATRICES = {
    **{f"separated by {mark!r}": csv(sep=mark, header=False) for mark in (",", ";", "\t", " ", "|")},
    "decimal commas": csv(sep=";", decimal=",", header=False),
    "decimal commas between blanks": csv(sep=" ", decimal=",", header=False),
    "commas and blanks, as savetxt has it": numpy(delimiter=", "),
    "tabs between groups, blanks within": lambda path, frame: path.write_text(
        "".join(f"{a!r}\t{b!r} {c!r}\t{d!r} {e!r}\t\n" for a, b, c, d, e in frame.to_numpy().tolist())
    ),
    "a separator that ends each row": lambda path, frame: path.write_text(
        frame.to_csv(header=False, index=False).replace("\n", ",\n")
    ),
    "columns that pandas numbers": lambda path, frame: pd.DataFrame(frame.to_numpy()).to_csv(path, index=False),
}


@pytest.mark.parametrize("case", MATRICES)
def test_numbers_without_names_are_an_array_of_the_files_name(case, known, tmp_path):
    """It was refused, so that a matrix of savetxt or of MATLAB's had to be written anew."""
    MATRICES[case](tmp_path / "log.txt", frame(known))
    with pytest.raises(InputError, match=r"name their columns \(columns, such as q=log\[0:2\]\); its columns are: log\[0:5\]"):
        bayesid.read_recording(tmp_path / "log.txt", known.urdf, joints=JOINTS)
    columns = {"t": "log[0]", "q": "log[1:3]", "tau": "log[3:5]"}
    table = bayesid.read_recording(tmp_path / "log.txt", known.urdf, joints=JOINTS, columns=columns).experiment.motions[0].table
    for name, values in (("times", known.t), ("positions", known.q), ("torques", known.tau)):
        np.testing.assert_allclose(getattr(table, name), values, rtol=0.0, atol=1e-12)


def test_a_row_of_numbers_that_is_cut_off_is_refused(known, tmp_path):
    numpy()(tmp_path / "log.txt", frame(known))
    with (tmp_path / "log.txt").open("a", encoding="utf-8") as file:
        file.write("2.0 0.1\n")
    with pytest.raises(InputError, match=r"log.txt: line 251: 2 cells where the first row has 5"):
        bayesid.read_recording(tmp_path / "log.txt", known.urdf, joints=JOINTS)


def test_a_header_of_groups_is_told_from_rows_that_are_cut_off(known, tmp_path):
    """It was said of the second line that a cell was missing."""
    (tmp_path / "log.txt").write_text("time\tpositions\n" + frame(known).to_csv(sep="\t", header=False, index=False))
    with pytest.raises(
        InputError, match=r"log.txt: line 1 names 2 columns, but every row has 5 cells; name each of them, or none"
    ):
        bayesid.read_recording(tmp_path / "log.txt", known.urdf, joints=JOINTS)


def test_a_row_between_blanks_that_is_cut_off_is_refused(known, tmp_path):
    numpy(header=" ".join(NAMES))(tmp_path / "log.txt", frame(known))
    text = (tmp_path / "log.txt").read_text(encoding="utf-8").replace("\n", "\n\n", 1)  # a blank line is none
    (tmp_path / "log.txt").write_text(text + "2.0 0.1\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"log.txt: line 253: 2 cells where the header has 5"):
        bayesid.read_recording(tmp_path / "log.txt", known.urdf, joints=JOINTS)
