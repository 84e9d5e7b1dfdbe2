"""Policy file headers that would block the loader indefinitely or leave the robot without a command."""

from pathlib import Path
from typing import Any

import pytest
from ctrl_rl_core.io import encode_tensors, read_tensors

from koopman_lqr_controller import KoopmanError, find_policy, load_policy

pytestmark = pytest.mark.fault


@pytest.mark.parametrize(
    ("name", "way", "value", "words"),
    [
        ("curved_corridor", ("observation", "count"), 10**12, "observation.count: is 1000000000000: "),
        ("curved_corridor", ("observation", "near"), 1e300, "observation.near: is 1e\\+300: "),
        ("curved_corridor", ("encoder", "shape"), [10**9], "encoder.shape.0: is 1000000000: "),
        ("curved_corridor", ("encoder", "shape"), [5000, 5000], "an observation of more than 1,000,000 numbers"),
        ("curved_corridor", ("encoder", "layers"), [{"kind": "flatten"}] * 10**5, "encoder.layers: "),
        ("curved_corridor", ("horizon",), 10**12, "horizon: is 1000000000000: "),
        ("curved_corridor", ("dt",), True, "dt: is True: "),
        ("curved_corridor", ("dt",), 1e300, "dt: is 1e\\+300: "),
        ("curved_corridor", ("manifest",), [], "manifest: "),
        ("curved_corridor_edmd", ("observables", "bearings_deg"), [10.0] * 10**5, "observables.bearings_deg: "),
        ("curved_corridor_edmd", ("observables", "half_width_deg"), float("nan"), "half_width_deg: is nan: "),
        ("curved_corridor_edmd", ("manifest", "dt"), "0.2", "manifest.dt: is '0.2': "),
        ("curved_corridor_edmd", ("format",), "x" * 4000, r"format is '[x']*\.\.\., must be"),
        ("curved_corridor_edmd", ("region", "error"), None, "region.error: is None: "),
    ],
)
def test_a_header_that_makes_no_sense_is_refused_in_one_line(
    tmp_path: Path, name: str, way: tuple[str, ...], value: Any, words: str
) -> None:
    header, tensors, _ = read_tensors(find_policy(name), "policy")
    parent = header
    for key in way[:-1]:
        parent = parent[key]
    parent[way[-1]] = value
    path = tmp_path / "policy.safetensors"
    path.write_bytes(encode_tensors(tensors, "policy", header))
    with pytest.raises(KoopmanError, match=words) as error:
        load_policy(path)
    assert str(error.value).isprintable()
    assert len(str(error.value)) < 700
