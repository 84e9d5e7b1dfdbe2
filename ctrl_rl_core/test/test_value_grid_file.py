import json
import os
import stat
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from ctrl_rl_core.values.value_grid import Axis, GridError
from hypothesis import given
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.numpy import save_file
from value_grids import make_grid, quickly, random_axes

from ctrl_rl_core import ValueGrid


def small_grid(**changes) -> ValueGrid:
    axes = [Axis("x", "m", -1.0, 1.0, 3), Axis("theta", "rad", -np.pi, np.pi, 4, periodic=True)]
    values = np.arange(12, dtype=np.float32).reshape(3, 4)
    values[1, 2] = np.inf
    return make_grid(values, axes, kind="time_to_reach", **changes)


@quickly
@given(
    st.integers(0, 2**32), st.integers(1, 6), st.sampled_from([np.float32, np.float64]), st.text(), st.floats(0, 1e9)
)
def test_round_trip(tmp_path_factory, seed, n, dtype, note, residual):
    random = np.random.default_rng(seed)
    axes = random_axes(random, n, periodic=True)
    values = random.uniform(0, 1, [axis.count for axis in axes]).astype(dtype)
    values[random.random(values.shape) < 0.1] = np.inf
    grid = make_grid(values, axes, kind="time_to_reach", notes={"note": note}, residual=residual)
    path = tmp_path_factory.mktemp("grids") / "grid.safetensors"
    grid.save(path)
    loaded = ValueGrid.load(path)
    for name in ("axes", "kind", "task", "task_digest", "solver", "residual", "notes", "unit", "digest"):
        assert getattr(loaded, name) == getattr(grid, name)
    assert loaded.values.dtype == dtype
    np.testing.assert_array_equal(loaded.values, grid.values)


def test_digest_is_that_of_the_file_and_tells_grids_apart(tmp_path):
    path = tmp_path / "grid.safetensors"
    small_grid().save(path)
    sha256sum = subprocess.run(["sha256sum", path], capture_output=True, text=True, check=True).stdout.split()[0]
    assert small_grid().digest == sha256sum
    assert small_grid(solver="another").digest != sha256sum
    assert replace(small_grid(), values=small_grid().values * 2).digest != sha256sum


def test_save_does_not_overwrite_unless_asked_and_leaves_no_debris(tmp_path):
    path = tmp_path / "grid.safetensors"
    small_grid().save(path)
    with pytest.raises(GridError, match=r"grid.safetensors: exists already"):
        small_grid(solver="new").save(path)
    assert ValueGrid.load(path).solver == "a test"
    small_grid(solver="new").save(path, overwrite=True)
    assert ValueGrid.load(path).solver == "new"
    assert os.listdir(tmp_path) == ["grid.safetensors"]
    assert stat.S_IMODE(path.stat().st_mode) & stat.S_IRUSR


def test_save_where_it_cannot(tmp_path):
    with pytest.raises(GridError, match="cannot be written: No such file or directory"):
        small_grid().save(tmp_path / "missing" / "grid.safetensors")
    (tmp_path / "folder").mkdir()
    with pytest.raises(GridError, match="cannot be written"):
        small_grid().save(tmp_path / "folder", overwrite=True)
    assert os.listdir(tmp_path) == ["folder"]


def test_every_truncation_is_refused(tmp_path):
    path = tmp_path / "grid.safetensors"
    small_grid().save(path)
    content = path.read_bytes()
    for length in [0, 4, 8, 40, *range(100, len(content), 97), len(content) - 1]:
        path.write_bytes(content[:length])
        with pytest.raises(GridError, match=r"grid\.safetensors: "):
            ValueGrid.load(path)


def test_flipped_values_are_refused(tmp_path):
    path = tmp_path / "grid.safetensors"
    small_grid().save(path)
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(GridError, match="does not match its digest"):
        ValueGrid.load(path)
    small_grid().save(path, overwrite=True)
    edited(path, values_sha256="0" * 64)
    with pytest.raises(GridError, match="do not match their checksum"):
        ValueGrid.load(path)


def edited(path, **changes) -> None:
    """Rewrite the description of a saved grid as in an earlier version; None removes a field."""
    with safe_open(path, framework="numpy") as file:
        description = json.loads(file.metadata()["value_grid"])
        values = file.get_tensor("values")
    description = {k: v for k, v in {**description, "sha256": None, **changes}.items() if v is not None}
    save_file({"values": values}, path, metadata={"value_grid": json.dumps(description)})


AXIS = {"name": "x", "unit": "m", "lower": -1, "upper": 1, "count": 3, "periodic": False}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": 2}, "format: is 2: must be 1"),
        ({"solver": None}, "solver: is missing"),
        ({"axes": None}, "axes: is missing"),
        ({"axes": 3}, "axes: is 3: must be a valid list"),
        ({"axes": [3]}, "axes.0: "),
        ({"axes": [AXIS]}, r"values have shape \(3, 4\), the axes \(3,\)"),
        ({"axes": [AXIS, {**AXIS, "count": 4}]}, "names repeat: x, x"),
        ({"axes": [AXIS, {**AXIS, "count": 4.0}]}, "axes.1.count: is 4.0: .*valid integer"),
        ({"axes": [AXIS, {**AXIS, "periodic": 1}]}, "axes.1.periodic: .*valid boolean"),
        ({"axes": [AXIS, {**AXIS, "upper": -1}]}, "give finite lower < upper"),
        ({"axes": [AXIS, {**AXIS, "lower": float("nan")}]}, "axes.1.lower: .*finite"),
        ({"kind": "speed"}, "kind: is 'speed': .*'time_to_reach', 'oc_value', 'avoid' or 'reach_avoid'"),
        ({"kind": "oc_value"}, "an optimal control value is infinite"),
        ({"kind": 4}, "kind: is 4: "),
        ({"task": ""}, "task: is ''"),
        ({"task_digest": "abc"}, "task_digest: "),
        ({"residual": float("nan")}, "residual: .*finite number"),
        ({"residual": "small"}, "residual: .*valid number"),
        ({"residual": -1}, "residual: .*or equal to 0"),
        ({"notes": {"a": 1}}, "notes.a: .*valid string"),
    ],
)
def test_bad_metadata_is_refused_by_name(tmp_path, changes, message):
    path = tmp_path / "grid.safetensors"
    small_grid().save(path)
    edited(path, **changes)
    with pytest.raises(GridError, match=r"grid\.safetensors: .*" + message):
        ValueGrid.load(path)


def test_other_files_are_refused_by_name(tmp_path):
    path = tmp_path / "grid.safetensors"
    with pytest.raises(GridError, match=r"grid\.safetensors: there is no such file"):
        ValueGrid.load(path)
    path.write_text("x: 1\n" * 10)
    with pytest.raises(GridError, match=r"grid\.safetensors: is not a whole safetensors file"):
        ValueGrid.load(path)
    save_file({"weights": np.zeros(3)}, path)
    with pytest.raises(GridError, match="another kind, 'without a header'"):
        ValueGrid.load(path)
    save_file({"values": np.zeros(3, np.int32)}, path, metadata={"value_grid": "{}"})
    with pytest.raises(GridError, match="type 'I32': must be F32 or F64"):
        ValueGrid.load(path)
    for text, message in (("{", "not valid JSON"), ("[]", "no JSON object")):
        save_file({"values": np.zeros(3)}, path, metadata={"value_grid": text})
        with pytest.raises(GridError, match=message):
            ValueGrid.load(path)
    with pytest.raises(GridError, match=f"{tmp_path}: is a folder"):
        ValueGrid.load(tmp_path)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([0, np.nan, 1], "NaN or -inf"),
        ([0, -np.inf, 1], "NaN or -inf"),
        ([0, -1.0, 1], r"a time to reach is negative \(-1 s\)"),
        (np.array([0, 1, 2]), "of type int64"),
        (np.zeros(3, np.float16), "of type float16"),
        (np.zeros(4), "shape"),
    ],
)
def test_bad_values_are_refused(values, message):
    with pytest.raises(GridError, match=message):
        make_grid(values, [Axis("x", "m", 0.0, 1.0, 3)], kind="time_to_reach")
