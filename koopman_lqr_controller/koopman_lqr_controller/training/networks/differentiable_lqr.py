"""The differentiable LQR of thesis Algorithm 1, and its limit: from A, B, Q, R to a gain, with gradients.

A is (n, n), B (n, m); Q (n,) and R (m,) are the diagonals of the costs of state and control.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

_INITIAL_DECAY = 0.95
"""Initial multiple of the identity in A; with independent normal entries its spectral radius would be about 6."""
_INITIAL_INFLUENCE = 0.1


def riccati_gain(A: Tensor, B: Tensor, Q: Tensor, R: Tensor, z_ref: Tensor, iterations: int) -> tuple[Tensor, Tensor]:
    """Return K (m, n) and k (m,) of u = k - K z for the goal z_ref (n,) after M `iterations` of Algorithm 1.

    See `riccati.finite_horizon` for the same without gradients.
    """
    P, v = torch.diag(Q), Q * z_ref
    R_full, Q_full = torch.diag(R), torch.diag(Q)
    for _ in range(iterations):
        PB = P @ B
        closed = A - B @ _solved(R_full + B.T @ PB, PB.T @ A)
        v = closed.T @ v + Q * z_ref
        P = A.T @ P @ closed + Q_full
        P = 0.5 * (P + P.T)
    PB = P @ B
    law = _solved(R_full + B.T @ PB, torch.cat((PB.T @ A, (B.T @ v)[:, None]), dim=1))
    return law[:, :-1], law[:, -1]


def _solved(M: Tensor, Y: Tensor) -> Tensor:
    """Return X of M X = Y; on a GPU a singular M is not detected, because a CUDA graph cannot wait for the check."""
    X: Tensor = torch.linalg.solve_ex(M, Y, check_errors=not M.is_cuda)[0]
    return X


def doubled_gain(A: Tensor, B: Tensor, Q: Tensor, R: Tensor, doublings: int = 6) -> Tensor:
    """Return K (m, n) of `riccati_gain` after 2 ** doublings - 1 iterations, practically the infinite horizon.

    Structure-preserving doubling (Chu, Fan, Lin 2005): each step doubles the time span of the map.
    """
    stretch, P = A, torch.diag(Q)
    G, eye = (B / R) @ B.T, torch.eye(len(Q), dtype=A.dtype, device=A.device)
    for _ in range(doublings):
        W = torch.linalg.inv(eye + G @ P)
        ahead = stretch @ W
        G, P, stretch = G + ahead @ G @ stretch.T, P + stretch.T @ P @ W @ stretch, ahead @ stretch
        G, P = 0.5 * (G + G.T), 0.5 * (P + P.T)
    PB = P @ B
    K: Tensor = torch.linalg.solve(torch.diag(R) + B.T @ PB, PB.T @ A)
    return K


class LatentLqr(nn.Module):
    """The Koopman operator A, B (Eq. 4.6) and the cost Q, R of its regulator (Eq. 4.8), all learnt.

    Attributes:
        A: State matrix (n, n).
        B: Control matrix (n, m).
        log_Q: Logarithm of Q's diagonal (n,).
        log_R: Logarithm of R's diagonal (m,).
        iterations: Number M of Riccati iterations.
    """

    def __init__(self, n: int, m: int, iterations: int) -> None:
        super().__init__()
        self.A = nn.Parameter(_INITIAL_DECAY * torch.eye(n))
        self.B = nn.Parameter(_INITIAL_INFLUENCE * torch.randn(n, m))
        self.log_Q = nn.Parameter(torch.zeros(n))
        self.log_R = nn.Parameter(torch.zeros(m))
        self.iterations = iterations

    def gain(self, z_ref: Tensor) -> tuple[Tensor, Tensor]:
        """Return K (m, n) and k (m,) for a goal (n,)."""
        return riccati_gain(self.A, self.B, self.log_Q.exp(), self.log_R.exp(), z_ref, self.iterations)

    def predict(self, z: Tensor, u: Tensor) -> Tensor:
        """Return the next z (N, n) for z (N, n) and actions (N, m) (Eq. 4.6)."""
        return z @ self.A.T + u @ self.B.T

    def model_loss(self, z: Tensor, u: Tensor, z_next: Tensor) -> Tensor:
        """Return the mean squared prediction error L_m (Eq. 4.7), summed over the latent state."""
        return (z_next - self.predict(z, u)).square().sum(dim=1).mean()
