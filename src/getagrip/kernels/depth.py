"""The distance of a posed mesh at some samples of an image, and how it changes as the mesh moves."""

from __future__ import annotations

import numpy as np

from getagrip.compiling import kernel
from getagrip.kernels.silhouette import project

LEAST_COSINE = 0.1
"""Samples whose ray meets the surface at a smaller cosine with its normal count as missed: they say where, not how far.
"""


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
        if along * along < LEAST_COSINE**2 * (q0 * q0 + q1 * q1 + 1.0):
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
    """Fill in the inverse distance of the nearest face at each pixel's centre, and which it is; -1: none.

    Inverse distances are linear in the image. Of a ``closed`` mesh, faces that look away are hidden.
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
    """Cut a span down to where ``at_zero + slope u`` is positive."""
    low, high = span
    if slope > 0.0:
        return max(low, -at_zero * inverse), high
    if slope < 0.0:
        return low, min(high, -at_zero * inverse)
    return (low, high) if at_zero >= 0.0 else (low, low)


@kernel()
def _between(low, high, size):
    """First and last, exclusive, of the pixels whose centres are between two places."""
    first, last = int(max(low + 0.5, 0.0)), int(min(max(high + 0.5, 0.0), 1.0 * size))
    return first + (first + 0.5 < low), last


@kernel()
def profile(r, weight, relief, on_hand, priors, sigma, tail, rounds, exact, u, left, sums, A, of_clip, of_frame):
    """Fit the errors of depth images to r (N, M) by iteratively reweighted least squares.

    Minimises ``sum of weight tail^2 log(1 + (left / (tail sigma))^2)`` and of ``prior error^2``, where ``left`` (N, M)
    is r without the errors: of_clip (3,) times relief, on_hand and 1, and of_frame (N,). ``priors`` are theirs (4,),
    sigma is that of each sample (N, M). Ends after ``rounds``, or when of_frame changes by less than ``exact``. Fills
    in ``left``, the weights ``u`` (N, M) of least squares, their ``sums`` (N, 8), and the normal matrix A (3, 3) of
    of_clip, below its diagonal.
    """
    N, M = r.shape
    y = np.empty(3)
    of_clip[:], of_frame[:] = 0.0, 0.0
    for n in range(N):
        for m in range(M):
            u[n, m] = weight[n, m] / sigma[n, m] ** 2
    for _ in range(rounds):
        _normal(r, u, relief, on_hand, priors, sums, A, y)
        _solve(A, y, of_clip)
        g, h, a, change = of_clip[0], of_clip[1], of_clip[2], 0.0
        for n in range(N):
            b = (sums[n, 5] - sums[n, 1] * g - sums[n, 2] * h - sums[n, 0] * a) / (sums[n, 0] + priors[3])
            change = max(change, abs(b - of_frame[n]))
            of_frame[n] = b
            for m in range(M):
                left[n, m] = r[n, m] - g * relief[n, m] - h * on_hand[n, m] - a - b
            for m in range(M):
                u[n, m] = weight[n, m] / (sigma[n, m] ** 2 + (left[n, m] / tail) ** 2)
        if change < exact:
            break
    _normal(r, u, relief, on_hand, priors, sums, A, y)


@kernel()
def _normal(r, u, relief, on_hand, priors, sums, A, y):
    """Fill in the normal equations of of_clip, those of each of_frame eliminated: A (3, 3) below its diagonal, y (3,).

    The sums over a frame's samples are those of u times 1, d, h, d d, d h, r, d r, h r, with d the relief and h 1 on
    the hand, else 0.
    """
    A[:], y[:] = 0.0, 0.0
    A[0, 0], A[1, 1], A[2, 2] = priors[0], priors[1], priors[2]
    for n in range(len(r)):
        s = sd = sh = sdd = sdh = sr = sdr = shr = 0.0
        for m in range(r.shape[1]):
            w, d, e = u[n, m], relief[n, m], r[n, m]
            h = w * on_hand[n, m]
            s += w
            sd += w * d
            sh += h
            sdd += w * d * d
            sdh += h * d
            sr += w * e
            sdr += w * d * e
            shr += h * e
        sums[n, 0], sums[n, 1], sums[n, 2], sums[n, 3] = s, sd, sh, sdd
        sums[n, 4], sums[n, 5], sums[n, 6], sums[n, 7] = sdh, sr, sdr, shr
        w = s + priors[3]
        A[0, 0] += sdd - sd * sd / w
        A[1, 0] += sdh - sd * sh / w
        A[1, 1] += sh - sh * sh / w
        A[2, 0] += sd - sd * s / w
        A[2, 1] += sh - sh * s / w
        A[2, 2] += s - s * s / w
        y[0] += sdr - sd * sr / w
        y[1] += shr - sh * sr / w
        y[2] += sr - s * sr / w


@kernel()
def _solve(A, y, x):
    """Solve ``A x = y`` for a positive definite A (3, 3), of which the lower half is given."""
    a, b, c, d, e, f = cholesky(A)
    t0, t1, t2 = forward(a, b, c, d, e, f, y[0], y[1], y[2])
    x[2] = t2 / f
    x[1] = (t1 - e * x[2]) / d
    x[0] = (t0 - b * x[1] - c * x[2]) / a


@kernel()
def cholesky(A):
    """Return the lower triangle L of ``A = L L^T`` (3, 3), row by row within columns: L00, L10, L20, L11, L21, L22."""
    a = np.sqrt(A[0, 0])
    b, c = A[1, 0] / a, A[2, 0] / a
    d = np.sqrt(A[1, 1] - b * b)
    e = (A[2, 1] - b * c) / d
    return a, b, c, d, e, np.sqrt(A[2, 2] - c * c - e * e)


@kernel()
def forward(a, b, c, d, e, f, y0, y1, y2):
    """Solve ``L t = y``, L as ``cholesky`` returns it."""
    t0 = y0 / a
    t1 = (y1 - b * t0) / d
    return t0, t1, (y2 - c * t0 - e * t1) / f
