"""Configuration files: what they may say, and the one line for each way to get it wrong."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from polhode.config import Config, Scene
from polhode.config.loader import dump_config, load_config, load_stored_config
from polhode.runtime.errors import InputError

BILLION = "a0: &a0 [x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]\n" for k in range(1, 10)
)
"""370 bytes that stand for two billion values."""


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def message_of(path: Path, overrides: dict[str, Any] | None = None) -> str:
    with pytest.raises(InputError) as caught:
        load_config(path, overrides)
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize(
    ("text", "changed"),
    [
        ("# nothing\n", {}),
        ("backend:\n  # accel_psd: 1\nseed: 3\n", {"seed": 3}),
        # PyYAML reads 1e-8 as text, as YAML 1.1 says.
        ("backend: {accel_psd: 1e-8}", {"backend": {"accel_psd": 1e-8}}),
    ],
)
def test_what_a_file_leaves_out_has_its_default(text: str, changed: dict[str, Any], tmp_path: Path) -> None:
    assert load_config(write(tmp_path / "c.yaml", text)) == Config.model_validate(changed)


def test_extends_is_relative_to_the_file_and_merges_deeply_and_overrides_win(tmp_path: Path) -> None:
    write(tmp_path / "base.yaml", "seed: 1\nbackend: {accel_psd: 1.0e-5, torque_psd: 1.0e-5}\n")
    write(tmp_path / "a" / "middle.yaml", "extends: ../base.yaml\nbackend: {torque_psd: 2.0e-5}\n")
    top = write(tmp_path / "a" / "top.yaml", "extends: middle.yaml\nbackend: {robust_scale: 2.5}\n")
    config = load_config(top)
    backend = config.backend
    assert config.seed == 1
    assert (backend.accel_psd, backend.torque_psd, backend.robust_scale) == (1e-5, 2e-5, 2.5)
    backend = load_config(top, {"backend.inertia": "ratios_axes", "backend.accel_psd": "1e-3"}).backend
    assert (backend.inertia, backend.accel_psd, backend.torque_psd) == ("ratios_axes", 1e-3, 2e-5)


def test_the_resolved_configuration_reads_back_equal_and_complete(tmp_path: Path) -> None:
    config = load_config(
        write(tmp_path / "c.yaml", "seed: 4\nbackend: {accel_psd: 1e-9}"), {"scene.frames": "7"}
    )
    text = dump_config(config)
    assert load_config(write(tmp_path / "resolved.yaml", text)) == config
    keys = [line.strip().partition(":")[0] for line in text.splitlines() if ":" in line]
    for section in (Config, type(config.backend), type(config.mapping), type(config.runtime), Scene):
        assert set(section.model_fields) <= set(keys)


def test_a_missing_file_is_named_with_who_wants_it(tmp_path: Path) -> None:
    missing = tmp_path / "none.yaml"
    assert message_of(missing) == f"{missing} is missing: give an existing configuration file"
    path = write(tmp_path / "c.yaml", "extends: none.yaml")
    assert f"{missing}, which {path} extends, is missing" in message_of(path)


def test_an_error_names_the_file_of_the_chain_that_made_it(tmp_path: Path) -> None:
    base = write(tmp_path / "base.yaml", "backend: {accel_psd: none}")
    top = write(tmp_path / "top.yaml", "extends: base.yaml\nbackend: {torque_psd: 1.0}")
    assert message_of(top).startswith(f"{base}: key 'backend.accel_psd': expected a number, got text 'none'")


def test_a_chain_of_extends_ends(tmp_path: Path) -> None:
    for k in range(40):
        write(tmp_path / f"{k}.yaml", f"extends: {k + 1}.yaml")
    assert "'extends' goes on over more than 16 files" in message_of(tmp_path / "0.yaml")
    write(tmp_path / "1.yaml", "extends: 0.yaml")
    assert "'extends' is circular" in message_of(tmp_path / "0.yaml")


def test_what_is_extended_must_be_a_small_regular_file(tmp_path: Path) -> None:
    assert "give a regular file" in message_of(write(tmp_path / "c.yaml", "extends: /dev/zero"))
    with (tmp_path / "huge").open("wb") as stream:
        stream.truncate(2**40)
    message = message_of(write(tmp_path / "c.yaml", "extends: huge"))
    assert "1 MB that a YAML file may have" in message


@pytest.mark.parametrize(
    "content",
    ["root:$6$salt$hash:19000:0:99999:7:::\nother:!:1:::\n", "root:$6$salt$hash:1:x\n", "- hash", "hash"],
)
def test_a_foreign_file_that_is_extended_is_not_repeated(tmp_path: Path, content: str) -> None:
    """A configuration of someone else may extend /etc/shadow: to YAML that is a text, or a long key."""
    write(tmp_path / "secret", content)
    message = message_of(write(tmp_path / "c.yaml", "extends: secret"))
    assert "at the top, got something else" in message or "a key that is not a name" in message
    assert "hash" not in message


BAD_FILES: dict[str, tuple[str, str]] = {
    "unknown key": (
        "backend: {inerta: ratios_axes}",
        "unknown key 'backend.inerta'; did you mean inertia? valid keys: inertia, ",
    ),
    "unknown section": (
        "bakend: {}",
        "unknown key 'bakend'; did you mean backend? valid keys: seed, outputs, ",
    ),
    "unknown deep key": ("scene: {body: {colour: red}}", "unknown key 'scene.body.colour'"),
    "number as key": ("1: 2", "unknown key '1'"),
    "unknown choice": (
        "backend: {inertia: ratios}",
        "key 'backend.inertia': expected one of second_moments, ratios_axes, got text 'ratios'",
    ),
    "text for number": (
        "backend: {accel_psd: small}",
        "key 'backend.accel_psd': expected a number, got text 'small'",
    ),
    "list for number": ("backend: {accel_psd: [1, 2]}", "expected a number, got list [1, 2]"),
    "true for number": ("backend: {accel_psd: true}", "expected a number, got true"),
    "section for number": ("seed: {a: 1}", "key 'seed': expected a whole number, got section"),
    "number for section": ("backend: 3", "key 'backend': expected a section with keys inertia"),
    "fraction for whole": ("seed: 1.5", "key 'seed': expected a whole number, got 1.5"),
    "out of range": ("backend: {accel_psd: -1}", "key 'backend.accel_psd': must be at least 1e-30, got -1"),
    "short list": ("scene: {motion: {spin_rpm: [1, 2]}}", "key 'scene.motion.spin_rpm.2': missing"),
    "text in list": (
        "scene: {motion: {spin_rpm: [1, 2, x]}}",
        "key 'scene.motion.spin_rpm.2': expected a list of 3, each a number, got text 'x'",
    ),
    "two faults": ("seed: x\nbackend: {accel_psd: y}", "(and 1 more)"),
    "inconsistent": ("scene: {body: {family: mesh}}", "key 'scene.body': family mesh needs 'path'"),
    "list at top": ("- 1", "expected keys such as 'frontend:' at the top, got list [1]"),
    "syntax": ("seed: 1\nbackend: {accel_psd: [1\n", "c.yaml line 3: not valid YAML"),
    "tab": ("backend:\n\tseed: 1", "c.yaml line 2: not valid YAML"),
    "aliases that stand for a billion values": (BILLION, "more than 200000 values, with those that aliases"),
    "endless alias": ("a: &a [*a]", "c.yaml line 1: an alias stands for a section that contains it"),
    "deep lists": ("a: " + "[" * 100_000, "c.yaml line 1: nested more than 32 deep"),
    "deep sections": ("{a: " * 100_000, "c.yaml line 1: nested more than 32 deep"),
    "key given twice": ("seed: 1\nbackend: {}\nseed: 2", "c.yaml line 3: key 'seed' is given twice"),
    "date": ("seed: 2024-99-99", "key 'seed': expected a whole number, got text '2024-99-99'"),
    "time": ("seed: 190:20:30", "key 'seed': expected a whole number, got text '190:20:30'"),
    "a Python object": ("seed: !!python/object/apply:os.getpid []", "c.yaml line 1: a type, 'python/object"),
    "binary": ("seed: !!binary aGVsbG8=", "c.yaml line 1: a type, 'binary'; write the plain value alone"),
    "100,000 digits": ("seed: " + "9" * 100_000, "c.yaml line 1: a number of 100000 characters"),
    "long key": (f"'{'a' * 500}': 1", "c.yaml line 1: a key of 500 characters"),
    "zero byte": ('frontend: {weights: {disk: "a\\0b"}}', "c.yaml line 1: a control character"),
    "escape": ("seed: \x1b[31m", "c.yaml: not valid YAML: control characters are not allowed"),
    "two documents": ("seed: 1\n---\nseed: 2", "c.yaml line 2: not valid YAML: but found another document"),
    "list as key": ("[1]: 2", "c.yaml line 1: a list or a section as a key"),
    "extends a list": ("extends: [a, b]", "'extends': expected the path of one file"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_bad_file_gives_one_line_with_file_key_and_what_is_valid(tmp_path: Path, name: str) -> None:
    text, expected = BAD_FILES[name]
    path = write(tmp_path / "c.yaml", text)
    message = message_of(path)
    assert expected in message
    assert message.startswith(str(path))


def test_a_bad_override_names_the_command_line(tmp_path: Path) -> None:
    path = write(tmp_path / "c.yaml", "")
    assert message_of(path, {"backend.inertia": "x"}).startswith(
        "command line: key 'backend.inertia': expected one of"
    )
    assert message_of(path, {"backend.x": "1"}).startswith(
        "command line: unknown key 'backend.x'; valid keys:"
    )


def test_a_part_of_the_configuration_is_written_and_read_back_alone() -> None:
    config = Config(seed=7, scene=Scene(frames=3))
    text = dump_config(config, keys=("seed", "scene"))
    assert set(yaml.safe_load(text)) == {"seed", "scene"}
    assert Config.model_validate(yaml.safe_load(text)) == config


def test_keys_that_an_earlier_version_stored_are_left_out_of_a_runs_configuration(tmp_path: Path) -> None:
    file = tmp_path / "config.yaml"
    file.write_text("seed: 3\npictures: {views: false, frames: 5}\nbackend: {inertia: ratios_axes, old: 1}\n")
    config = load_stored_config(file)
    assert (config.seed, config.pictures.frames, config.backend.inertia) == (3, 5, "ratios_axes")
    with pytest.raises(InputError, match=r"unknown key 'backend\.old'"):
        load_config(file)
    file.write_text("seed: red")
    with pytest.raises(InputError, match="seed"):
        load_stored_config(file)
