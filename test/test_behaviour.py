"""The command that compares behaviour, on a case that takes a second."""

import json
import subprocess
import sys
from pathlib import Path

BEHAVIOUR = Path(__file__).with_name("behaviour")


def behaviour(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, BEHAVIOUR, *map(str, arguments)], capture_output=True, text=True, timeout=250, check=False
    )


def test_the_same_is_found_again_and_a_change_is_named(tmp_path: Path) -> None:
    before, now = tmp_path / "before.json", tmp_path / "now.json"
    first = behaviour("--output", before, "--only", "drive", "bag_info", "bag_recover")
    assert first.returncode == 0, first.stdout + first.stderr
    same = behaviour("--output", now, "--only", "drive", "bag_info", "bag_recover", "--against", before)
    assert same.returncode == 0, same.stdout + same.stderr
    report = json.loads(before.read_text(encoding="utf-8"))
    assert {"drive", "bag_info", "bag_recover", "bag_recover.header"} == set(report["lines"])
    parts = report["lines"]["bag_recover"]["parts"]
    topic = next(iter(parts))
    parts[topic] = "0" * 16
    report["lines"]["drive"]["parts"].pop("/scan")
    before.write_text(json.dumps(report), encoding="utf-8")
    changed = behaviour("--output", now, "--only", "drive", "bag_recover", "--against", before)
    assert changed.returncode == 1
    assert f"DIFFERS  bag_recover: changed 1: {topic}" in changed.stdout
    assert "DIFFERS  drive: gained 1: /scan" in changed.stdout


def test_a_file_that_is_no_output_is_refused_before_anything_is_run(tmp_path: Path) -> None:
    (tmp_path / "other.json").write_text("{}", encoding="utf-8")
    answer = behaviour("--output", tmp_path / "now.json", "--against", tmp_path / "other.json")
    assert answer.returncode == 2
    assert answer.stderr.startswith("behaviour: ")
    assert len(answer.stderr.splitlines()) == 1
    assert not (tmp_path / "now.json").exists()
