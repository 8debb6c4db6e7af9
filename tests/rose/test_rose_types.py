"""Types and their versions: old and new robots understand each other."""

from __future__ import annotations

import pytest

import rose
from rose.core.types import decode_message, encode_message, info_of, type_id
from rose.errors import TypeMismatchError
from tests.rose.messages import Pose


@rose.message("test/pose_v2", version=2)
class NewPose(rose.Message, array_like=True, frozen=True):
    x_m: float
    y_m: float
    heading_rad: float = 0.0


def test_an_older_reader_ignores_what_it_does_not_know() -> None:
    assert decode_message(encode_message(NewPose(1.0, 2.0, 3.0)), Pose) == Pose(1.0, 2.0)


def test_a_newer_reader_takes_the_default_for_what_is_missing() -> None:
    assert decode_message(encode_message(Pose(1.0, 2.0)), NewPose) == NewPose(1.0, 2.0, 0.0)


def test_golden_bytes_of_a_message() -> None:
    assert encode_message(Pose(1.0, -2.0)) == bytes.fromhex("92 cb3ff0000000000000 cbc000000000000000")
    assert type_id("test/pose") == bytes.fromhex("c20f564a")


def test_one_name_is_one_class() -> None:
    with pytest.raises(ValueError, match="its name stands for Pose"):

        @rose.message("test/pose")
        class Other(rose.Message, array_like=True, frozen=True):
            z_m: float


def test_a_class_that_was_not_registered_is_named() -> None:
    class Stranger(rose.Message, array_like=True, frozen=True):
        z_m: float

    with pytest.raises(TypeMismatchError, match=r"Stranger is no message type; decorate it with @rose.message"):
        info_of(Stranger)


def test_a_slice_has_to_be_a_field() -> None:
    with pytest.raises(ValueError, match="there is no field 'z_m'"):

        @rose.message("test/wrong", sliced="z_m")
        class Wrong(rose.Message, array_like=True, frozen=True):
            y_m: list[float]
