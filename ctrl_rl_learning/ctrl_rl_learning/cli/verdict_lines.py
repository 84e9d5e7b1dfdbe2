"""Format a policy's report as text: estimates, their support, the verdict, and what to record next."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ctrl_rl_learning.offline.evaluation.verdict import OfflineReport
    from ctrl_rl_learning.study.results import Estimate

_WORDS = {
    "better": "better than the driver of the bags",
    "not shown": "not shown to be better than the driver of the bags",
    "worse": "worse than the driver of the bags",
}


def estimates_of(report: OfflineReport) -> dict[str, Estimate]:
    """Return the available estimates by their names in the table."""
    estimates = {
        "driver of the bags": report.driver,
        "fitted Q evaluation": report.fitted_q,
        "doubly robust": report.doubly_robust,
        "roll-outs in the model": report.model,
        "gain, fitted Q": report.gain,
        "gain, doubly robust": report.robust_gain,
        "gain, roll-outs": report.model_gain,
        "success, policy": report.success,
        "success, gain": report.success_gain,
        "time lost, policy": report.time_lost,
        "time lost, driver": report.driver_time_lost,
        "time to goal, value": report.predicted_time,
        "time to goal, bags": report.recorded_time,
    }
    return {name: estimate for name, estimate in estimates.items() if estimate is not None}


def estimate_lines(report: OfflineReport) -> list[str]:
    """Return lines about the estimates and the data that support them."""
    lines = [f"{'discounted return':<22} mean       95 % interval"]
    lines += [f"{name:<22} {estimate}" for name, estimate in estimates_of(report).items()]
    seen = "unknown" if report.held_out is None else f"{report.held_out} of {report.episodes}"
    lines.append(f"held out   episodes that the policy was not fitted to: {seen}")
    all_of = f"of {report.episodes} episodes"
    lines.append(
        f"fitted Q   rests on {report.effective_episodes:.1f} {all_of}; the driver would have given "
        f"{report.coverage:.0%} of the policy's commands"
    )
    support = report.support
    if support is not None:
        lines.append(
            f"roll-outs  rest on {support.effective:.1f} {all_of}; {support.outside:.0%} of the steps lie where nobody "
            f"drove, {support.beyond:.0%} are beyond the recorded commands\n"
            f"           the model replays the bags with a correlation of {support.agreement:.2f}, two replays have "
            f"{support.attainable:.2f}; it misses the ends of {support.pieces} pieces like the policy's by "
            f"{support.missed:.0%}\n"
            f"           {support.scans_off:.1%} of the ranges are not those of the walls; the models differ by "
            f"{support.disagreement:.0f}"
        )
    lines.append(f"go by      {'roll-outs in the model' if report.by_model else 'fitted Q evaluation'}")
    return lines


def verdict_lines(report: OfflineReport) -> list[str]:
    """Return lines with the verdict and what to record next."""
    success = f"success {report.success.mean:.0%} beside {report.driver_success:.0%}"
    wanted = dict.fromkeys(objection.record for objection in report.objections)
    return [f"verdict    {_WORDS[report.verdict]}, {success}", *(f"record     {drives}" for drives in wanted)]
