"""The damped Gauss-Newton step of a motion's parameters where frames are tied only by the parameters that they share.

A compiled form of ``least_squares.BlockArrow`` for local vectors of 7 numbers: each frame's own parameters are
eliminated by a Cholesky factor of their few rows, so that time and memory grow linearly with the frames.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.compiling import kernel
from getagrip.fitting.energy import Quadratic, Ties
from getagrip.fitting.motion import Prior

NO_PAIR = np.zeros(0, int)
MIN_PIVOT_FRACTION = 1e-14
"""Smallest pivot of a Cholesky factor, as a share of the diagonal: what rounding leaves of a singular matrix."""


def damped_steps(
    J_shared: Float[ndarray, "B N 7 S"],
    J_local: Float[ndarray, "B N 7 L"],
    local: Quadratic,
    prior: Prior,
    R_cam_hand: Float[ndarray, "N 3 3"],
    damping: Float[ndarray, "B"],
    floor: float,
    max_turn: float,
) -> tuple[Float[ndarray, "B S"], Float[ndarray, "B N L"]]:
    """Solve for the step of the shared and of each frame's own parameters, cut to a maximum turn of every frame.

    ``floor`` is the curvature of directions that leave the energy unchanged [px^2 per m^2 or rad^2]; ``max_turn`` is
    in radians, and a shift of 10 cm counts as one. ``local.ties`` count as they say; ``local.cross`` is not read.
    """
    B, N, S, L = *J_shared.shape[:2], J_shared.shape[-1], J_local.shape[-1]
    g_shared = np.zeros((B, S)) if prior.g_shared is None else prior.g_shared
    diagonal_shared = np.zeros(S) if prior.diagonal_shared is None else prior.diagonal_shared
    shared, own, contiguous = np.zeros((B, S)), np.zeros((B, N, L)), np.ascontiguousarray
    diagonal = np.zeros((N, L)) + prior.diagonal
    ties = local.ties or Ties(NO_PAIR, NO_PAIR, np.zeros((B, 0, 7, 7)), local.H)
    _damped_steps(
        contiguous(J_shared), contiguous(J_local), local.H, local.g, contiguous(R_cam_hand), contiguous(diagonal),
        contiguous(prior.g), diagonal_shared, g_shared, ties.first, ties.second, ties.block, ties.bound, damping, floor,
        max_turn, shared, own,
    )  # fmt: skip
    return shared, own


@kernel("f4 f4 f4 f3 f3 f2 f3 f1 f2 i1 i1 f4 f4 f1 f f f2 f3")
def _damped_steps(
    J_shared, J_local, H, g, R, diagonal, g_local, diagonal_shared, g_shared, first, second, block, bound, damping,
    floor, max_turn, shared, own,
):  # fmt: skip
    """Fill in shared (B, S) and own (B, N, L)."""
    B, N, S = J_shared.shape[0], J_shared.shape[1], J_shared.shape[3]
    L = J_local.shape[3]
    J = np.empty((N, 7, S + L))
    own_rows, shared_rows = np.empty((N, L, L)), np.empty((N, L, S + 1))
    total, right, product = np.empty((S, S)), np.empty(S), np.empty((7, S + L))
    around = np.empty((N if len(first) else 0, 7, S))
    for b in range(B):
        for i in range(S):
            right[i] = g_shared[b, i]
            total[i, :] = 0.0
            total[i, i] = diagonal_shared[i]
        for n in range(N):
            _turn_rows(R[n], J_shared[b, n], J[n, :, :S])
            _turn_rows(R[n], J_local[b, n], J[n, :, S:])
            _add_frame(J[n], H[b, n], g[b, n], S, product, total, right, own_rows[n], shared_rows[n])
            for k in range(L):
                own_rows[n, k, k] += diagonal[n, k]
                shared_rows[n, k, S] += g_local[b, n, k]
            if len(first):
                _add_bound(J[n], bound[b, n], S, product, own_rows[n])
        around[:] = 0.0
        for pair in range(len(first)):
            i, j = first[pair], second[pair]
            _multiply_pair(block[b, pair], J[i], J[j], S, around[i], around[j])
        for n in range(len(around)):
            _add_pairs(J[n], around[n], S, total, shared_rows[n])
        _damp(total, damping[b], floor)
        for n in range(N):
            _damp(own_rows[n], damping[b], floor)
            _cholesky(own_rows[n])
            _forward(own_rows[n], shared_rows[n])
            _eliminate(shared_rows[n], total, right)
        _cholesky(total)
        _solve_vector(total, right)
        for i in range(S):
            shared[b, i] = -right[i]
        most = 0.0
        for n in range(N):
            _solve_own(own_rows[n], shared_rows[n], shared[b], own[b, n])
            most = max(most, _length(J_shared[b, n], shared[b], J_local[b, n], own[b, n]))
        if most > max_turn:
            shared[b] *= max_turn / most
            own[b] *= max_turn / most


@kernel()
def _turn_rows(R, J, out):
    """Copy a Jacobian (7, k) of shift, turn and scale with its vectors turned by R."""
    for j in range(J.shape[1]):
        for i in range(3):
            out[i, j] = R[i, 0] * J[0, j] + R[i, 1] * J[1, j] + R[i, 2] * J[2, j]
            out[3 + i, j] = R[i, 0] * J[3, j] + R[i, 1] * J[4, j] + R[i, 2] * J[5, j]
        out[6, j] = J[6, j]


@kernel()
def _multiply(H, J, out):
    for i in range(7):
        out[i, :] = 0.0
        for k in range(7):
            h = H[i, k]
            for j in range(J.shape[1]):
                out[i, j] += h * J[k, j]


@kernel()
def _add_frame(J, H, g, S, product, total, right, own, mixed):
    """Add ``J^T H J`` and ``J^T g`` to the lower half of total (S, S) and to right (S,).

    The frame's own parts are own (L, L) and mixed (L, S + 1), whose last column is the gradient.
    """
    _multiply(H, J, product)
    own[:], mixed[:] = 0.0, 0.0
    for k in range(7):
        for i in range(S):
            x = J[k, i]
            right[i] += x * g[k]
            for j in range(i + 1):
                total[i, j] += x * product[k, j]
        for i in range(len(own)):
            x = J[k, S + i]
            mixed[i, S] += x * g[k]
            for j in range(S):
                mixed[i, j] += x * product[k, j]
            for j in range(i + 1):
                own[i, j] += x * product[k, S + j]


@kernel()
def _add_bound(J, bound, S, product, own):
    """Add ``J^T bound J``, J by the frame's own parameters, to the lower half of own (L, L)."""
    _multiply(bound, J, product)
    for k in range(7):
        for i in range(len(own)):
            for j in range(i + 1):
                own[i, j] += J[k, S + i] * product[k, S + j]


@kernel()
def _multiply_pair(block, J_i, J_j, S, around_i, around_j):
    """Add ``block J_j`` to around_i (7, S), and ``block^T J_i`` to around_j, by the shared parameters."""
    for k in range(7):
        for m in range(7):
            x = block[k, m]
            for s in range(S):
                around_i[k, s] += x * J_j[m, s]
                around_j[m, s] += x * J_i[k, s]


@kernel()
def _add_pairs(J, around, S, total, mixed):
    """Add a frame's Hessians with its partners, but for the part by both frames' own parameters."""
    for k in range(7):
        for i in range(S):
            for j in range(i + 1):
                total[i, j] += J[k, i] * around[k, j]
        for i in range(len(mixed)):
            for j in range(S):
                mixed[i, j] += J[k, S + i] * around[k, j]


@kernel()
def _damp(A, damping, floor):
    for i in range(len(A)):
        A[i, i] += damping * (A[i, i] + floor)


@kernel()
def _eliminate(rows, total, right):
    """Subtract what a frame's own parameters explain, from total (S, S) and right (S,)."""
    S = len(right)
    for row in rows:
        for i in range(S):
            right[i] -= row[i] * row[S]
            for j in range(i + 1):
                total[i, j] -= row[i] * row[j]


@kernel()
def _cholesky(A):
    """Replace the lower half of A by its Cholesky factor."""
    for i in range(len(A)):
        for j in range(i):
            x = A[i, j]
            for k in range(j):
                x -= A[i, k] * A[j, k]
            A[i, j] = x / A[j, j]
        x = A[i, i]
        least = MIN_PIVOT_FRACTION * x
        for k in range(i):
            x -= A[i, k] * A[i, k]
        A[i, i] = np.sqrt(x if x > least else least)


@kernel()
def _forward(factor, right):
    """Solve ``factor x = right`` for the columns of right (L, k), in place."""
    for i in range(len(factor)):
        for j in range(i):
            f = factor[i, j]
            for k in range(right.shape[1]):
                right[i, k] -= f * right[j, k]
        f = 1.0 / factor[i, i]
        for k in range(right.shape[1]):
            right[i, k] *= f


@kernel()
def _backward(factor, x):
    """Solve ``factor^T y = x`` in place."""
    for i in range(len(x) - 1, -1, -1):
        for j in range(i + 1, len(x)):
            x[i] -= factor[j, i] * x[j]
        x[i] /= factor[i, i]


@kernel()
def _solve_own(factor, rows, shared, own):
    """Fill in a frame's own step (L,) after the shared one."""
    S = len(shared)
    for k in range(len(own)):
        own[k] = -rows[k, S]
        for i in range(S):
            own[k] -= rows[k, i] * shared[i]
    _backward(factor, own)


@kernel()
def _solve_vector(factor, x):
    """Solve ``factor factor^T y = x`` in place."""
    for i in range(len(x)):
        for j in range(i):
            x[i] -= factor[i, j] * x[j]
        x[i] /= factor[i, i]
    _backward(factor, x)


@kernel()
def _length(J_shared, shared, J_local, own):
    """Return a frame's turn [rad] or ten times its shift [m], whichever is larger."""
    squared = np.zeros(6)
    for i in range(6):
        for j in range(len(shared)):
            squared[i] += J_shared[i, j] * shared[j]
        for j in range(len(own)):
            squared[i] += J_local[i, j] * own[j]
    shift = squared[0] ** 2 + squared[1] ** 2 + squared[2] ** 2
    turn = squared[3] ** 2 + squared[4] ** 2 + squared[5] ** 2
    return np.sqrt(max(turn, 100.0 * shift))
