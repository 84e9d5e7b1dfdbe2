"""The report of a pre-flight: lines for people, JSON for programs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

from ctrl_rl_core.io.atomic_write import atomic_write

from ctrl_rl_bringup.preflight.finding import Finding, Level, Limits
from ctrl_rl_bringup.preflight.inspection import may_go


def as_text(findings: Sequence[Finding]) -> str:
    """Return a line for each finding, one for what to do about it, and the verdict."""
    lines = []
    for finding in findings:
        lines.append(f"{finding.level.value:<9} {finding.check:<24} {finding.text}")
        if finding.advice:
            lines.append(f"{'':<34}> {finding.advice}")
    return "\n".join((*lines, "", verdict(findings)))


def verdict(findings: Sequence[Finding]) -> str:
    """Return go or no-go in one line."""
    count = {level: sum(finding.level is level for finding in findings) for level in Level}
    rest = f"{count[Level.OK]} ok, {count[Level.NOTE]} to note, {count[Level.LEFT_OUT]} left out"
    return f"GO: {rest}" if may_go(list(findings)) else f"NO-GO: {count[Level.NO_GO]} wrong, {rest}"


def write_report(folder: Path, findings: Sequence[Finding], limits: Limits) -> None:
    """Write preflight.txt and preflight.json into a folder, each atomically.

    Raises:
        OSError: A file cannot be written; the error names it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "go": may_go(list(findings)),
        "findings": [{**asdict(finding), "level": finding.level.value} for finding in findings],
        "limits": asdict(limits),
    }
    atomic_write(folder / "preflight.json", json.dumps(content, indent=1) + "\n")
    atomic_write(folder / "preflight.txt", as_text(findings) + "\n")
