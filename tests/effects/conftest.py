"""Arms that the tests of effects share."""

import pytest

from tests.effects.arms import load


@pytest.fixture(scope="session")
def panda(tmp_path_factory):
    return load(tmp_path_factory.mktemp("panda"), "panda")


@pytest.fixture(scope="session")
def wrist(tmp_path_factory):
    return load(tmp_path_factory.mktemp("wrist"), "wrist_sensor_arm")


@pytest.fixture(scope="session")
def slider(tmp_path_factory):
    return load(tmp_path_factory.mktemp("slider"), "prismatic_arm")
