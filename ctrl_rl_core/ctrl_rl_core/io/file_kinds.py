"""Descriptions of the suite's safetensors files, by the key of their header."""

from __future__ import annotations

KINDS = {
    "policy": "a Koopman policy, for koopman_lqr_controller's controller (policy:=FILE)",
    "option_policy": "a joint option policy, for option_coordinator's coordinator (policy:=FILE)",
    "actor": "an actor-1 network of a learning run, for Python's ctrl_rl_training.io.actor.Actor; no node drives by it",
    "checkpoint": "a learning run's checkpoint, for the command that wrote it, which goes on from there",
    "visits": "states that a learning run visited, for the figures that its package draws",
    "value_grid": "a value grid, for ttr_reward_node's reward or oc_baseline_node's baseline (grid:=FILE)",
    "decomposed_value": "a time to reach in parts, for ttr_reward_node's reward (grid:=FILE)",
    "oc_value": "an optimal control value, for oc_baseline_node's baseline (grid:=FILE)",
}


def describe_kind(key: str) -> str:
    """Return the description of a file with this key in its header; for an unknown key the key itself."""
    return KINDS.get(key, f"'{key}'")
