"""The Stein control variate: c(s, a) = psi_w(s, a) beside the learnt V(s), fitted to the advantages ("FitQ").

Liu et al., "Action-dependent Control Variates for Policy Optimization via Stein's Identity", ICLR 2018.
psi is fitted after the policy has learnt from a roll-out, to be used on the next: fitted before, it would know the
very actions that it is subtracted for, and Stein's identity would not hold.
"""

from __future__ import annotations

import torch
from torch import nn

from oc_baseline_node.training.baselines.control_variates import ControlVariatePpo, value_and_slope


class SteinPpo(ControlVariatePpo):
    """PPO with the Stein control variate."""

    def variate(
        self, observations: torch.Tensor, actions: torch.Tensor, _: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return psi (N,) and its slope (N, m)."""
        return value_and_slope(self.critic, observations, actions)

    def fit_after(self) -> None:
        """Fit psi to the roll-out's advantages."""
        for _ in range(self.n_epochs):
            for data in self.rollout_buffer.get(self.batch_size):
                found = self.critic(torch.cat((data.observations, data.actions), dim=1)).flatten()
                loss = nn.functional.mse_loss(found, data.advantages)
                self.critic_optimizer.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                self.critic_optimizer.step()
