"""Configuration: every mistake at once, with file and key; nothing ignored."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from udp_mesh import config, config_checks
from udp_mesh.config import Config, ConfigError
from udp_mesh.core.settings import Keep, Offline, Reliability, TopicPolicy


def test_a_whole_file_is_read(tmp_path: Path) -> None:
    file = tmp_path / "node.toml"
    file.write_text(
        'name = "robot1"\nport = 8701\ninterfaces = ["wlan0"]\nwindow = 3\nprobe = false\nbeacon_interval_s = 2\n'
        '[topics.fpv]\npriority = 9\nreliability = "best_effort"\nkeep = "latest"\n'
        'lifetime_s = 1.5\noffline = "latest"\n'
    )
    read = config.load(str(file))
    assert (read.name, read.port, read.interfaces, read.window, read.probe) == ("robot1", 8701, ("wlan0",), 3, False)
    policy = TopicPolicy(9, Reliability.BEST_EFFORT, Keep.LATEST, 1.5, Offline.LATEST)
    assert read.topics["fpv"] == policy
    assert read.settings().policy("fpv") == policy
    assert read.settings().policy("other") == TopicPolicy()
    assert read.payload_bytes == Config().payload_bytes == 1400
    assert read.team == ()


def test_all_mistakes_are_reported_together(tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(
        'name = "all"\nport = 0\nwindow = -1\nprioritize = true\nkey = "secret"\nprobe = 1\n'
        '[topics.a]\npriority = 256\nkeep = "newest"\noffline = "storage"\nredundancy = 9\n'
    )
    with pytest.raises(ConfigError) as caught:
        config.load(str(file))
    problems = caught.value.problems
    assert all(problem.startswith(f"{file}: ") for problem in problems)
    keys = [problem.removeprefix(f"{file}: ").split(":")[0] for problem in problems]
    assert keys == [
        *("name", "port", "window", "prioritize", "key", "probe"),
        *("topics.a.priority", "topics.a.keep", "topics.a.offline", "topics.a.redundancy"),
    ]
    assert "secret" not in "".join(problems)
    assert "known are" in problems[keys.index("prioritize")]


def test_keys_are_read_and_never_shown() -> None:
    first, second = "00" * 32, "f7" * 32
    one = config.parse({"key": first}, source="f")
    two = config.parse({"key": [first, second]}, source="f")
    assert one.settings().keys == (bytes(32),)
    assert two.settings().keys == (bytes(32), b"\xf7" * 32)
    for read in (one, two, config.change(one, "key", f'["{first}", "{second}"]')):
        shown = repr(read) + json.dumps(config.describe(read))
        assert first not in shown
        assert second not in shown
        assert "\\xf7" not in shown
    with pytest.raises(ConfigError, match=r"list of 1\.\.4"):
        config.parse({"key": []}, source="f")


def test_a_key_without_its_package_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(config_checks, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"f: key: needs the Python package cryptography; install it: pip install"):
        config.parse({"key": "00" * 32}, source="f")


def test_a_missing_or_broken_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: cannot be read: No such file"):
        config.load(str(tmp_path / "none.toml"))
    (tmp_path / "broken.toml").write_text("name = \n")
    with pytest.raises(ConfigError, match=r"broken\.toml: is not TOML"):
        config.load(str(tmp_path / "broken.toml"))


def test_settings_change_at_run_time_with_the_same_checks() -> None:
    start = Config(name="n")
    assert config.change(start, "window", "3").window == 3
    assert config.change(start, "probe", "false").probe is False
    changed = config.change(start, "topics.a.b.priority", "7")
    assert changed.topics["a.b"].priority == 7
    changed = config.change(changed, "topics.a.b.keep", "latest")
    assert (changed.topics["a.b"].priority, changed.topics["a.b"].keep) == (7, Keep.LATEST)
    for key, value in (
        ("name", '"x"'),
        ("port", "1"),
        ("window", "many"),
        ("topics.a.priority", "1000"),
        ("nope", "1"),
    ):
        with pytest.raises(ConfigError):
            config.change(start, key, value)


@given(
    st.dictionaries(
        st.text(max_size=12), st.one_of(st.none(), st.booleans(), st.integers(), st.text(), st.lists(st.integers()))
    )
)
def test_any_table_is_accepted_or_refused_with_its_keys(table: dict[str, object]) -> None:
    with contextlib.suppress(ConfigError):
        config.parse(table, source="f")


def test_carriers_are_read() -> None:
    lines = (
        '[[carriers]]\nkind = "udp"\ninterfaces = ["wlan0"]\n[[carriers]]\nkind = "serial"\ndevice = "/dev/ttyUSB0"\n'
    )
    read = config.parse(config.tomllib.loads(lines + "baud = 9600\nmtu_bytes = 255\n"), source="f")
    radio, serial = read.carriers
    assert (radio.kind, radio.interfaces) == ("udp", ("wlan0",))
    assert (serial.device, serial.baud, serial.mtu_bytes, serial.rate_bps) == ("/dev/ttyUSB0", 9600, 255, 7680)
    assert [carrier.kind for carrier in Config().carriers] == ["udp"]
    json.dumps(config.describe(read))


@pytest.mark.parametrize(
    ("carriers", "problem"),
    [
        ([], r"has to be tables like \[\[carriers\]\]"),
        ([{"kind": "lora"}], r"\[0\]\.kind has to be one of udp, udp6, ethernet, serial"),
        ([{"kind": "udp", "device": "/dev/x"}], r"\[0\]\.device is no key of kind udp; known are kind, interfaces"),
        ([{"kind": "serial"}], r"\[0\] needs device, such as /dev/ttyUSB0"),
        ([{"kind": "udp"}, {"kind": "serial", "device": "tty"}], r"\[1\]\.device has to be a path"),
        ([{"kind": "serial", "device": "/d", "baud": 9601}], r"\[0\]\.baud has to be a speed that serial lines have"),
        ([{"kind": "serial", "device": "/d", "mtu_bytes": 199}], r"from 200 to 65000"),
        ([{"kind": "serial", "device": "/d", "rate_bps": True}], r"\[0\]\.rate_bps has to be a number"),
        ([{"kind": "serial", "device": "/d"}, {"kind": "serial", "device": "/d"}], "names one device twice"),
    ],
)
def test_mistakes_in_carriers_say_what_is_expected(carriers: list[dict[str, object]], problem: str) -> None:
    with pytest.raises(ConfigError, match=f"f: carriers: .*{problem}"):
        config.parse({"carriers": carriers}, source="f")
