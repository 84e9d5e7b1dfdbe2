"""The analysis as a readable page: findings, explanations of the figures, and omissions."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

Found = Mapping[str, Any]

_TITLES = {
    "poles": "Poles",
    "controllability": "Controllability",
    "costs": "Costs",
    "observations": "What the costs weigh in the observation",
    "prediction": "Prediction",
    "limits": "What limits the prediction",
    "tsne": "Map of the latent states",
    "closed_loop": "The closed loop on the real system",
}
_OTHER = {"true_poles": "poles of the true system", "latents": "spread of the latents", "data": "episodes or drives"}


def page(found: Found, name: str, pictures: Mapping[str, str]) -> str:
    """Format the page as Markdown.

    Args:
        found: Findings of `analyse`.
        name: Name of the policy's file.
        pictures: File names of the figures, by part.
    """
    out = [f"# {name}", _about(found)]
    for part, title in _TITLES.items():
        if part not in found:
            continue
        out.append(f"## {title}")
        out.append(_TEXTS[part](found))
        if part in pictures:
            out.append(f"![{_alternative(title, found, part)}]({pictures[part]})")
            out.append(_caption(found, title))
    left = found["left_out"]
    if left:
        out.append("## Left out")
        names = {**_TITLES, **_OTHER}
        out.append("\n".join(f"- {names.get(part, part)}: {reason}" for part, reason in left.items()))
    return "\n\n".join(out) + "\n"


def _alternative(title: str, found: Found, part: str) -> str:
    """Return the alternative text of a figure: its finding with the number."""
    sentence = re.split(r"(?<!Fig)\. ", _TEXTS[part](found).partition("\n")[0])[0].rstrip(".")
    return title if set("[]|") & set(sentence) else sentence


def _caption(found: Found, title: str) -> str:
    data = found.get("data")
    seen = f", {data['episodes']} episodes" if data else ""
    return f"*{title}: one policy{seen}. Drawn by `analyse` from [the data](analysis.json).*"


def _about(found: Found) -> str:
    policy = found["policy"]
    kind = {
        "as learnt": f"as learnt: the gain after {policy['riccati_iterations']} Riccati iterations",
        "consolidated": "consolidated: the infinite-horizon LQR of its own model",
        "two stages": "two stages: EDMD with fixed observables, then its LQR",
    }[policy["kind"]]
    rows = [
        ("task", policy["task"]),
        ("policy", kind),
        ("Q and R", policy["costs"]),
        ("latent dimensions, controls", f"{policy['latent']}, {policy['controls']}"),
        ("spectral radius of A - B K", f"{policy['spectral_radius']:.4f}"),
    ]
    if "data" in found:
        data = found["data"]
        rows.append(("seen and done", f"{data['episodes']} episodes, {data['steps']} steps from {data['source']}"))
    return "| | |\n|---|---|\n" + "\n".join(f"| {name} | {value} |" for name, value in rows)


def _poles(found: Found) -> str:
    open_, closed = (np.hypot(*np.array(found["poles"][which]).T) for which in ("open", "closed"))
    text = (
        f"Of the model's {len(open_)} poles {int(np.sum(open_ > 1.0))} lie outside the unit circle without control, "
        f"the farthest at {open_[0]:.3f}; with the policy {int(np.sum(closed > 1.0))}, the farthest at {closed[0]:.3f}."
    )
    true = found.get("true_poles")
    if true is None:
        return text
    lines = [text, "", f"The true system is {true['about']}, linearised by finite differences in the same time step."]
    lines += ["", "| true pole | without control | with the policy |", "|---|---|---|"]
    closed_true = true["closed"] or []
    for index, pole in enumerate(true["open"]):
        other = "-"
        if index < len(closed_true):
            other = f"{_number(closed_true[index])}, nearest of the model {true['nearest_closed'][index]:.3f} away"
        lines.append(f"| {index + 1} | {_number(pole)}, nearest {true['nearest_open'][index]:.3f} away | {other} |")
    lines.append("")
    lines.append(
        "With the policy the real system comes to rest, and its own poles there are the right-hand column."
        if closed_true
        else true["why"]
    )
    return "\n".join(lines)


def _controllability(found: Found) -> str:
    part = found["controllability"]
    low, high = part["ranks"][0], part["ranks"][-1]
    pbh = np.array(part["pbh"])
    sizes = np.hypot(*np.array(found["poles"]["open"]).T)
    fast = pbh[sizes >= 1.0]
    text = (
        f"Kalman's rank depends on the tolerance: {low} at 1e-16, {part['usual_rank']} at the usual one, {high} near "
        f"1. Evenly used, its directions would be {part['participation_ratio']:.1f} (participation ratio). "
        f"By the PBH test the least controllable mode is {pbh.min():.1e} of the model's norm away from being out of "
        "reach"
    )
    text += f"; of those that do not fade, {fast.min():.1e}." if len(fast) else "; all of them fade by themselves."
    if "latents" in found:
        latents = found["latents"]
        text += (
            f" What is met uses {latents['participation_ratio']:.1f} directions evenly, and {latents['components_99']} "
            "hold 99 % of the variance: latent dimensions beyond these say nothing new."
        )
    return text


def _costs(found: Found) -> str:
    Q = np.sort(np.array(found["costs"]["Q"]))[::-1]
    share = np.cumsum(Q) / max(Q.sum(), 1e-300)
    R = ", ".join(f"{value:.3g}" for value in found["costs"]["R"])
    source = {
        "as learnt": "as it was learnt with the task as its judge (thesis Fig. 4.5)",
        "by inverse LQR": "not as learnt: of all costs that explain the policy (inverse LQR), one choice; "
        "Fig. 4.5 and 4.7 of the thesis are of the learnt file",
        "by hand": "chosen by hand, read back from gain and cost-to-go",
    }[found["policy"]["costs"]]
    half = int(np.searchsorted(share, 0.5) + 1)
    return f"Q is {source}. {half} of its {len(Q)} entries hold half of its sum. R is {R}."


def _observations(found: Found) -> str:
    part = found["observations"]
    if "patch" in part:
        return (
            f"Patches of {part['patch']} pixels are hidden in turn; bright ones matter to the cost (thesis Fig. 4.7)."
        )
    order = np.argsort(-np.array(part["cost"]))[:3]
    names = ", ".join(part["names"][index] for index in order)
    return (
        "The Jacobian J of the encoder turns Q into weights of the observation, E[J'QJ], each component in units of "
        f"its spread (thesis Fig. 4.7). The heaviest: {names}."
    )


def _prediction(found: Found) -> str:
    ratio = found["prediction"]["over_persistence"]
    told = ", ".join(f"{ratio[step - 1]:.2f} after {step}" for step in (1, 2, 5, 10, 20) if step <= len(ratio))
    verdict = "beats" if ratio[0] < 1.0 else "is worse than"
    return (
        "Error over that of 'nothing changes', going on from the model's own prediction under the controls that were "
        f"done: {told} steps. One step ahead the model {verdict} persistence. In what the law asks for, K z, "
        "which is the same in all coordinates of the latent space, the error is "
        f"{found['prediction']['law_over_persistence']:.2f} of that of persistence."
    )


def _limits(found: Found) -> str:
    lines = [
        "| what is hard | noise in the actions | model | K z | best linear | noise alone | model over best linear |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in found["limits"]["rows"]:
        errors = [row["model"], row["law"], row["linear_floor"], row["noise_floor"]]
        errors.append(row["model"] / max(row["linear_floor"], 1e-12))
        lines.append(f"| {row['name']} | {row['noise']:g} | " + " | ".join(f"{each:.2f}" for each in errors) + " |")
    return "\n".join(lines) + (
        "\n\nErrors of one step over that of 'nothing changes', from the same starts. No model misses less than the "
        "noise alone makes it, as two looks at each state tell. No linear model of these latents misses less than the "
        "best linear one, fitted to these very steps: where that is far above the noise, the rest is not linear."
    )


def _tsne(_: Found) -> str:
    return (
        "Where both colours cover each other, one step of the linear model is right (thesis Fig. 4.4). The map keeps "
        "neighbours, not distances."
    )


def _closed_loop(found: Found) -> str:
    part = found["closed_loop"]
    returns = np.array(part["returns"])
    text = f"{len(returns)} fresh episodes of the real system: return {returns.mean():.1f} (least {returns.min():.1f})."
    ended: Sequence[str] = part["outcomes"]
    if ended:
        text += " Ended with " + ", ".join(f"{it.lower()} {list(ended).count(it)}" for it in sorted(set(ended))) + "."
    last = [np.median([trace[-1] / max(trace[0], 1e-12) for trace in part[name]]) for name in
            ("cost_to_go", "cost_to_go_of_the_model_alone")]  # fmt: skip
    return (
        f"{text} The cost to go ends at {last[0]:.1e} of its start; the model alone would promise {last[1]:.1e}. "
        "The lifted model's promise proves nothing about the robot; only the black lines are evidence."
    )


def _number(pole: Sequence[float]) -> str:
    real, imaginary = pole
    return (
        f"{real:.3f}" if abs(imaginary) < 5e-4 else f"{real:.3f} {'+' if imaginary > 0 else '-'} {abs(imaginary):.3f}i"
    )


_TEXTS: Mapping[str, Callable[[Found], str]] = {
    "poles": _poles,
    "controllability": _controllability,
    "costs": _costs,
    "observations": _observations,
    "prediction": _prediction,
    "limits": _limits,
    "tsne": _tsne,
    "closed_loop": _closed_loop,
}
