"""The config: strict, layered, self-describing; errors say where and what to do."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, ValidationError

from mfslam.config import Config, OdometryConfig
from mfslam.settings import Layers, describe, did_you_mean, load, preset_names, preset_path
from mfslam.types import MfslamError


def write(folder: Path, text: str, name: str = "user.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def error_of(files=(), settings=()) -> str:
    with pytest.raises(MfslamError) as caught:
        load(files, settings)
    return str(caught.value)


def test_nothing_said_is_the_defaults():
    assert load() == Config()


def test_later_layers_win(tmp_path):
    first = write(tmp_path, "map:\n  resolution_m: 0.1\n  min_hits: 3\n", "first.yaml")
    second = write(tmp_path, "map:\n  resolution_m: 0.2\n", "second.yaml")
    both = load([first, second], ["map.min_hits=5"])
    assert (both.map.resolution_m, both.map.min_hits) == (0.2, 5)
    assert load([second, first]).map.resolution_m == 0.1
    assert both.map.max_range_m == Config().map.max_range_m


def test_unknown_key_names_file_line_and_nearest(tmp_path):
    path = write(tmp_path, "# a comment\nmap:\n  min_hits: 2\n  resolution: 0.1\n")
    assert error_of([path]).startswith(
        f"{path}:4: map.resolution: no such setting; did you mean resolution_m?"
    )


def test_unknown_stage_names_file_line_and_nearest(tmp_path):
    path = write(tmp_path, "maps:\n  resolution_m: 0.1\n")
    assert error_of([path]).startswith(f"{path}:2: maps: no such setting; did you mean map?")


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("map:\n  resolution_m: 0\n", 2, "greater than 0"),
        ("map:\n  resolution_m: fine\n", 2, "valid number"),
        ("map:\n  min_hits: 1.5\n", 2, "integer"),
        ("map:\n  resolution_m: .nan\n", 2, "finite"),
        ("map:\n  resolution_m: .inf\n", 2, "finite"),
        ("deskew:\n  mode: poses\n", 2, "'pose'"),
        ("map: 5\n", 1, "map"),
        ("- map\n", 1, "stage"),
        ("map:\n  a: [1\n", 3, "not valid YAML"),
        ("map:\n  min_hits: 1\n  min_hits: 2\n", 3, "duplicate"),
        ("map:\n  resolution_m: 0.1\n\tmin_hits: 2\n", 3, "not valid YAML"),
    ],
)
def test_bad_values_name_file_and_line(tmp_path, text, line, said):
    path = write(tmp_path, text)
    message = error_of([path])
    assert message.startswith(f"{path}:{line}:")
    assert said in message


def test_every_fault_is_told_at_once(tmp_path):
    path = write(tmp_path, "map:\n  resolution_m: -1\nicp_: 3\ndeskew:\n  mode: no\n")
    lines = error_of([path]).splitlines()
    assert sorted(line.split(":")[1] for line in lines) == ["2", "3", "5"]


def test_error_points_at_the_layer_that_said_it(tmp_path):
    good = write(tmp_path, "map:\n  min_hits: 3\n", "good.yaml")
    bad = write(tmp_path, "\nmap:\n  min_hits: 0\n", "bad.yaml")
    assert error_of([good, bad]).startswith(f"{bad}:3: map.min_hits")
    assert load([bad], ["map.min_hits=4"]).map.min_hits == 4
    assert error_of([good], ["map.min_hits=-1"]).startswith("--set map.min_hits=-1: map.min_hits")


def test_layers_of_any_stages_remember_who_spoke_last(tmp_path):
    path = write(tmp_path, "robot:\n  wheels:\n    track_m: 0.4\n")
    layers = Layers({"robot": {"wheels": {"track_m": 0.3, "swap_sides": False}, "name": "a"}})
    assert layers.where(("robot", "wheels", "track_m")) == "defaults"
    layers.read(path)
    layers.set("robot.name=b")
    assert layers.values == {"robot": {"wheels": {"track_m": 0.4, "swap_sides": False}, "name": "b"}}
    assert layers.where(("robot", "wheels", "track_m")) == f"{path}:3"
    assert layers.where(("robot", "name", "below")) == "--set robot.name=b"
    assert layers.where(("laser",)) == "defaults"


def test_a_near_name_is_offered_and_no_far_one():
    assert did_you_mean("resolution", ["min_hits", "resolution_m"]) == "; did you mean resolution_m?"
    assert did_you_mean("zzz", ["min_hits", "resolution_m"]) == ""


def test_files_that_are_none(tmp_path):
    assert "cannot be read" in error_of([tmp_path / "absent.yaml"])
    assert "cannot be read" in error_of([tmp_path])
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x80")
    assert "binary" in error_of([binary])
    assert load([write(tmp_path, "# only a comment\n")]) == Config()


def test_yaml_anchors_and_merges_keep_their_lines(tmp_path):
    text = "map: &common\n  min_hits: 3\nodometry:\n  <<: *common\n"
    assert "odometry.min_hits: no such setting" in error_of([write(tmp_path, text)])


@pytest.mark.parametrize("setting", ["map.min_hits", "=3", "map", ""])
def test_settings_without_form_are_refused(setting):
    assert "expected stage.key=value" in error_of([], [setting])


@pytest.mark.parametrize(
    "setting", ["map.min_hits=[1", "map.min_hits={", "map.min_hits=*x", "map.min_hits=a: b: c"]
)
def test_settings_with_broken_values_are_refused(setting):
    assert error_of([], [setting]).startswith(f"--set {setting}:")


def test_setting_below_a_value_is_refused(tmp_path):
    path = write(tmp_path, "map: 5\n")
    assert "map.min_hits" in error_of([path], ["map.min_hits=1"])


@settings(max_examples=150, deadline=None)
@given(st.text(alphabet="abmp.:=_-{}[]&*!|>'\"#%@,\n 0123456789", max_size=40))
def test_no_setting_ends_in_anything_but_a_clear_error(text):
    try:
        loaded = load([], [text])
    except MfslamError as error:
        assert str(error)
    else:
        assert isinstance(loaded, Config)


def test_null_asks_the_log(tmp_path):
    path = write(tmp_path, "sensor:\n  range_max_m: 4\n")
    assert load([path], ["sensor.range_max_m=null"]).sensor.range_max_m is None


def test_described_config_reads_back_the_same(tmp_path):
    changed = load(
        settings=[
            "sensor.name='a: b # c'",
            "sensor.transport_delay_s=-0.15",
            "sensor.mount_x_m=1e-3",
            "sensor.reversed_beams=true",
            "wheels.left_joint='null'",
            "deskew.mode=none",
        ]
    )
    for every in (Config(), changed):
        assert load([write(tmp_path, describe(every))]) == every


def test_every_setting_is_described():
    text = describe()
    for stage_name, stage in Config.model_fields.items():
        model = stage.annotation
        assert isinstance(model, type) and issubclass(model, BaseModel)
        assert f"{stage_name}:" in text and model.__doc__
        for key, info in model.model_fields.items():
            assert info.description, f"{stage_name}.{key} has no description"
            assert f"  {key}: " in text


def test_config_is_frozen():
    with pytest.raises(ValidationError):
        Config().map.min_hits = 3  # type: ignore[misc]


def test_every_preset_loads_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "generic" in preset_names()
    for name in preset_names():
        load([preset_path(name)])


def test_presets_by_path_and_unknown_ones(tmp_path):
    path = write(tmp_path, "map:\n  min_hits: 3\n")
    assert preset_path(str(path)) == path
    with pytest.raises(MfslamError, match="did you mean generic"):
        preset_path("generik")


def test_a_copy_with_another_value_computes_with_it():
    config = OdometryConfig()
    before = config.step_noise
    looser = config.model_copy(update={"sigma_floor_m": 1.0})
    assert before[0, 0] == config.sigma_floor_m and looser.step_noise[0, 0] == 1.0
