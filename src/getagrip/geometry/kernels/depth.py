"""Depth of a posed mesh at samples of an image, its derivatives by the pose, and robust fits of depth errors."""

from __future__ import annotations

import numpy as np

from getagrip.compiling import kernel
from getagrip.geometry.kernels.silhouette import project

WARP_STUDENT_DOF = 2.0
"""Degrees of freedom of Student's t, for errors that warp depth: small in most images, arbitrary in wrong ones."""
MIN_INCIDENCE_COSINE = 0.1
"""Cosine between ray and surface normal below which a sample counts as missed: its depth is too uncertain."""


@kernel()
def distances(
    vertices, planes, faces, closed, R, centre, scale, K, place, first, end, size, uvz, nearest, face, log_z, J
):
    """Fill in log_z (M,) and its derivatives J (M, 7) by the local 7-vector, at the samples from ``first`` to ``end``.

    ``vertices`` (3, V) and the faces' ``planes`` (4, F), outward normal and distance, are about the centre, posed as
    ``scale R x + centre``; samples are at the rows and columns ``place`` (M, 2) of an image of ``size`` pixels a side.
    NaN where a ray misses the mesh. Work space: uvz (3, V), nearest and face (size, size). Returns whether the mesh can
    be rendered (``silhouette.project``).

    A point x of the surface with normal n moves along its ray as ``d log z = n . dx / n . x``.
    """
    if not project(vertices, R, centre, scale, K, uvz):
        return False
    _render(faces, closed, uvz, size, nearest, face)
    fx, fy, cx, cy = 1.0 / K[0], 1.0 / K[1], K[2], K[3]
    c0, c1, c2 = centre[0], centre[1], centre[2]
    for m in range(first, end):
        f = face[place[m, 0], place[m, 1]]
        log_z[m] = np.nan
        if f < 0:
            continue
        p0, p1, p2 = planes[0, f], planes[1, f], planes[2, f]
        n0 = R[0, 0] * p0 + R[0, 1] * p1 + R[0, 2] * p2
        n1 = R[1, 0] * p0 + R[1, 1] * p1 + R[1, 2] * p2
        n2 = R[2, 0] * p0 + R[2, 1] * p1 + R[2, 2] * p2
        q0, q1 = (place[m, 1] + 0.5 - cx) * fx, (place[m, 0] + 0.5 - cy) * fy
        along = n0 * q0 + n1 * q1 + n2
        if along * along < MIN_INCIDENCE_COSINE**2 * (q0 * q0 + q1 * q1 + 1.0):
            continue
        whole = n0 * c0 + n1 * c1 + n2 * c2 - scale * planes[3, f]  # n . x
        z = whole / along
        log_z[m] = np.log(z)
        n0, n1, n2 = n0 / whole, n1 / whole, n2 / whole
        a0, a1, a2 = z * q0 - c0, z * q1 - c1, z - c2
        J[m, 0], J[m, 1], J[m, 2] = n0, n1, n2
        J[m, 3], J[m, 4], J[m, 5] = a1 * n2 - a2 * n1, a2 * n0 - a0 * n2, a0 * n1 - a1 * n0
        J[m, 6] = n0 * a0 + n1 * a1 + n2 * a2
    return True


@kernel()
def _render(faces, closed, uvz, size, nearest, face):
    """Fill in the inverse distance and the index (-1: none) of the nearest face at each pixel's centre.

    Inverse distances are linear in the image. A ``closed`` mesh's back faces are hidden.
    """
    nearest[:] = 0.0
    face[:] = -1
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ua, ub, uc, va, vb, vc = uvz[0, a], uvz[0, b], uvz[0, c], uvz[1, a], uvz[1, b], uvz[1, c]
        area = (ub - ua) * (vc - va) - (vb - va) * (uc - ua)
        if area == 0.0 or (closed and area > 0.0):
            continue
        top, bottom = _between(min(va, vb, vc), max(va, vb, vc), size)
        if top >= bottom:
            continue
        left, right = _between(min(ua, ub, uc), max(ua, ub, uc), size)
        if left >= right:
            continue
        bu, bv, cu, cv = (vc - va) / area, (ua - uc) / area, (va - vb) / area, (ub - ua) / area
        au, av = -bu - cu, -bv - cv
        ia = 1.0 / uvz[2, a]
        ib, ic = 1.0 / uvz[2, b] - ia, 1.0 / uvz[2, c] - ia
        wide = right - left > 2  # else each pixel is tested
        ra, rb, rc = 1.0 / au, 1.0 / bu, 1.0 / cu
        for i in range(top, bottom):
            v = i + 0.5 - va
            first, last = left, right
            if wide:  # where all three shares are positive: long thin faces are common
                low, high = _cut(
                    1.0 + av * v, au, ra, _cut(bv * v, bu, rb, _cut(cv * v, cu, rc, (left - ua, right - ua)))
                )
                if not low < high:
                    continue
                first, last = _between(low + ua, high + ua, size)
            for j in range(first, last):
                u = j + 0.5 - ua
                b_share, c_share = bu * u + bv * v, cu * u + cv * v
                inverse = ia + b_share * ib + c_share * ic
                if b_share >= 0.0 and c_share >= 0.0 and b_share + c_share <= 1.0 and inverse > nearest[i, j]:
                    nearest[i, j], face[i, j] = inverse, f


@kernel()
def _cut(at_zero, slope, inverse, span):
    """Cut a span to the part with positive ``at_zero + slope u``."""
    low, high = span
    if slope > 0.0:
        return max(low, -at_zero * inverse), high
    if slope < 0.0:
        return low, min(high, -at_zero * inverse)
    return (low, high) if at_zero >= 0.0 else (low, low)


@kernel()
def _between(low, high, size):
    """Return the first and last (exclusive) pixel with a centre between two positions."""
    first, last = int(max(low + 0.5, 0.0)), int(min(max(high + 0.5, 0.0), 1.0 * size))
    return first + (first + 0.5 < low), last


@kernel()
def profile(r, weight, modes, priors, rigid, sigma, tail, rounds, exact, u, left, sums, A, of_clip, of_frame):
    """Fit the errors of depth images to r (N, M) by iteratively reweighted least squares.

    Minimises ``sum of weight tail^2 log(1 + (left / (tail sigma))^2)`` and the ``prior_cost`` of the errors, where
    ``left`` (N, M) is r without them: of_clip (K,) times ``modes`` (N, K, M), and of_frame (N,). sigma (N, M) is each
    sample's. Ends after ``rounds``, or when no error changes by more than ``exact``. Fills in ``left``, the weights
    ``u`` (N, M) of least squares, their ``sums`` (N, K + 2), and the factor A (K, K) of the normal matrix of of_clip
    (``_factorise``).
    """
    (N, M), K = r.shape, len(of_clip)
    y, weighted = np.empty(K), np.empty(M)
    of_clip[:], of_frame[:] = 0.0, 0.0
    for n in range(N):
        for m in range(M):
            u[n, m] = weight[n, m] / sigma[n, m] ** 2
    for _ in range(rounds):
        _normal(r, u, modes, priors, rigid, of_clip, sums, A, y, weighted)
        forward(A, y)
        change = 0.0
        for k in range(K - 1, -1, -1):
            for o in range(k + 1, K):
                y[k] -= A[o, k] * y[o]
            y[k] /= A[k, k]
            change = max(change, abs(y[k] - of_clip[k]))
            of_clip[k] = y[k]
        for n in range(N):
            b = (sums[n, K + 1] - dot(of_clip, sums[n])) / sums[n, K]
            change = max(change, abs(b - of_frame[n]))
            of_frame[n] = b
            for m in range(M):
                left[n, m] = r[n, m] - b
            for k in range(K):
                add(left[n], -of_clip[k], modes[n, k])
            for m in range(M):
                u[n, m] = weight[n, m] / (sigma[n, m] ** 2 + (left[n, m] / tail) ** 2)
        if change < exact:
            break
    _normal(r, u, modes, priors, rigid, of_clip, sums, A, y, weighted)


@kernel()
def prior_cost(of_clip, priors, rigid):
    """Compute the cost of the errors shared by all frames, and a quadratic prior with the slope of the warps'.

    Warps are the errors after the first ``rigid``: Student's t. ``priors`` (K + 1,) are the quadratic ones.
    """
    total, warps = 0.0, 0.0
    for k in range(len(of_clip)):
        square = priors[k] * of_clip[k] ** 2
        if k < rigid:
            total += square
        else:
            warps += square
    return total + WARP_STUDENT_DOF * np.log1p(warps / WARP_STUDENT_DOF), priors[rigid] / (
        1.0 + warps / WARP_STUDENT_DOF
    )


@kernel()
def _normal(r, u, modes, priors, rigid, of_clip, sums, A, y, weighted):
    """Fill in the normal equations of of_clip with each of_frame eliminated: y (K,), and the factor of A (K, K).

    The sums of a frame are those of u times each mode, of u and its prior, and of u r. Work space: weighted (M,).
    """
    (N, M), K = r.shape, len(of_clip)
    A[:], y[:] = 0.0, 0.0
    _, wide = prior_cost(of_clip, priors, rigid)
    for k in range(K):
        A[k, k] = priors[k] if k < rigid else wide
    for n in range(N):
        sums[n, K], sums[n, K + 1] = priors[K], dot(u[n], r[n])
        for m in range(M):
            sums[n, K] += u[n, m]
        for k in range(K):
            for m in range(M):
                weighted[m] = u[n, m] * modes[n, k, m]
            sums[n, k] = dot(u[n], modes[n, k])
            f = sums[n, k] / sums[n, K]
            y[k] += dot(weighted, r[n]) - f * sums[n, K + 1]
            for o in range(k + 1):
                A[k, o] += dot(weighted, modes[n, o]) - f * sums[n, o]
    _factorise(A)


@kernel()
def _factorise(A):
    """Replace a positive definite A (K, K), given by its lower half, by the lower L of ``A = L L^T``."""
    for k in range(len(A)):
        for o in range(k + 1):
            for j in range(o):
                A[k, o] -= A[k, j] * A[o, j]
            A[k, o] = np.sqrt(A[k, k]) if o == k else A[k, o] / A[o, o]


@kernel()
def forward(L, y):
    """Replace y (K,) by the x of ``L x = y``."""
    for k in range(len(y)):
        for o in range(k):
            y[k] -= L[k, o] * y[o]
        y[k] /= L[k, k]


@kernel()
def add(y, a, x):
    """Add a times the first len(y) numbers of x to y."""
    for k in range(len(y)):
        y[k] += a * x[k]


@kernel()
def dot(x, y):
    """Return the product of x with the first len(x) numbers of y."""
    total = 0.0
    for k in range(len(x)):
        total += x[k] * y[k]
    return total
