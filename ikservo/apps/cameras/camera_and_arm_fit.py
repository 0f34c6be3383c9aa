"""Joint estimate of the camera and the arm from pictures of a board on the gripper.

A sample consists of the measured joint positions and the pose of the board in the camera. With the
pose C of the arm's base in the camera, the pose B of the board on the tip, and the forward
kinematics f with zeros, compliance and backlash (``kinematics.bending``), the board is predicted at
``C f(q) B``. The estimate minimises ``Σ (e_k / σ_k)² + Σ ((x_j - m_j) / s_j)²`` over all samples: e
has six rows in the frame of the ray to the board. The deviations σ across the ray, along it, of the
turn about it and of the tilt differ by a factor of ten; the residuals give them (variance
components). m and s are the prior mean and deviation of x. Parameters that the pictures do not
determine keep their prior; otherwise, the zero of a last joint, which turns the board, would follow
the smallest model error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from ikservo.errors import CalibrationError
from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector
from ikservo.kinematics.bending_and_backlash import Bending
from ikservo.kinematics.joints import JointType
from ikservo.kinematics.se3 import exp_so3, log_so3, make_pose, skew

MIN_SAMPLES = 6
_Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class LensTerms(FrozenArrays):
    """Linearised information about the lens from the corners of a board in one picture.

    The six numbers are: focal length over width, minus 1; ratio of the vertical to the horizontal
    focal length, minus 1; offset of the principal point from the middle over width, right and down;
    k1 and k2 of the distortion.

    Attributes:
        at: The numbers (6,) with which the pose of the board was computed.
        by_lens: The derivative (6, 6) of that pose with respect to the six numbers: rows are
            metres and rad, camera frame.
        slope: The derivative (6,) of half the squared error of the corners with respect to the
            six numbers, with the best pose for each.
        information: The second derivative (6, 6).
        noise: The covariance (6, 6) of that pose due to noise of the corners; rows as ``by_lens``.
    """

    at: Vector
    by_lens: Matrix
    slope: Vector
    information: Matrix
    noise: Matrix


@dataclass(frozen=True, slots=True, eq=False)
class BoardSample(FrozenArrays):
    """One view of the board on the gripper by a camera.

    Attributes:
        q: The measured joints (dof,), rad or m.
        T_camera_board: The board's pose (4, 4); its origin should be in the middle of the board.
        name: The name of the picture.
        lens: Information on the lens of the camera; None if the lens is known.
    """

    q: Vector
    T_camera_board: Matrix
    name: str = ""
    lens: LensTerms | None = None


class Extent(Enum):
    """The parameters that are estimated besides the poses of camera and board."""

    CAMERA = "camera"
    ZEROS = "camera and zeros"
    BENDING = "camera and bending"
    ARM = "camera, zeros and bending"
    EVERYTHING = "camera, zeros, bending and backlash"

    @property
    def zeros(self) -> bool:
        """Whether zeros are estimated."""
        return self in (Extent.ZEROS, Extent.ARM, Extent.EVERYTHING)

    @property
    def bending(self) -> bool:
        """Whether compliances are estimated."""
        return self in (Extent.BENDING, Extent.ARM, Extent.EVERYTHING)


@dataclass(frozen=True, slots=True)
class FittedParameter:
    """One estimated parameter of the arm.

    Attributes:
        name: The name: ``elbow_flex zero``, ``elbow_flex compliance``, ``elbow_flex half play``.
        unit: rad, rad/N m; m and m/N for a prismatic joint.
        value: The estimate.
        deviation: The standard deviation of the estimate.
        prior: The prior standard deviation.
    """

    name: str
    unit: str
    value: float
    deviation: float
    prior: float

    @property
    def is_determined(self) -> bool:
        """Whether the pictures give more information about the parameter than the prior."""
        return self.deviation < _DETERMINED * self.prior


# Prior standard deviations.
_ZERO_RAD = math.radians(3.0)  # a zero set by eye
_ZERO_M = 0.002  # the same for a slide
_COMPLIANCE = 0.1  # rad per N m: printed links
_HALF_PLAY_RAD = math.radians(0.25)  # half the backlash of gears
_HALF_PLAY_M = 0.0003  # the same for a slide
_POSE = 100.0  # m or rad; camera and board may be anywhere
_SCALE = 0.005  # ratio; prints are checked with a ruler
_LENS = (1.0, 0.003, 0.05, 0.05, 0.2, 0.2)  # for the six numbers of LensTerms
_POSES = 12 + 1 + 6  # parameters before those of the arm: two poses, the scale and the lens

# The components of a residual, and the component of each of its rows.
_ACROSS, _DEPTH, _TILT, _TURN = range(4)
_COMPONENT = np.array([_ACROSS, _ACROSS, _DEPTH, _TILT, _TILT, _TURN])
_DETERMINED = math.sqrt(0.5)  # of the prior deviation: prior and pictures weigh equally there
# Only the bending of the arm distinguishes the zero of the last joint from the mount of the board.
# Its deviation must therefore be smaller: at half of the prior deviation, the zero was 5° wrong.
_LAST_DETERMINED = 0.1
_START_SIGMA = np.array([0.002, 0.01, 0.05, 0.02])  # initial deviations: m, m, rad, rad
_ASSUMED = 6.0  # the ratios of the initial deviations count like this many samples
_FINEST = 0.02  # smallest estimated deviations, as a fraction of the initial ones
# A sample is an outlier if its squared deviations exceed the median by this factor.
_OUTLIER = 12.0
# The expected median for the initial deviations; it is smaller for few samples, which are fitted
# closely.
_EXPECTED = 3.0
_MAX_OUTLIER_FRACTION = 1.0 / 3.0
_IMPLAUSIBLE = 250.0  # largest median of the squared deviations; it corresponds to centimetres
_ROUNDS = 4  # rounds of choosing outliers or deviations
_STEPS = 30  # largest number of minimisation steps
_ENOUGH = 1e-7  # relative decrease of the cost that ends the minimisation
_MAX_DAMPING = 1e6  # a larger damping ends the minimisation
_STARTS = 40  # number of random subsets of the samples to start from
_START_SAMPLES = 5  # number of samples in each subset


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """The estimated poses and arm parameters, to which each step of the minimisation is added."""

    camera: Matrix
    board: Matrix
    scale: float
    lens: Vector
    arm: Vector

    def moved(self, step: Vector) -> _State:
        return _State(
            _turned(self.camera, step[:6]),
            _turned(self.board, step[6:12]),
            self.scale + float(step[12]),
            self.lens + step[13:_POSES],
            self.arm + step[_POSES:],
        )


@dataclass(frozen=True, slots=True, eq=False)
class CameraFit(FrozenArrays):
    """Camera, board and arm fitted to some samples.

    Attributes:
        bending: The arm and its bending.
        extent: The parameters that were estimated.
        T_camera_base: The pose (4, 4) of the arm's base.
        T_tip_board: The pose (4, 4) of the board on the tip.
        scale: The fraction by which the board was printed larger than specified, and by which its
            distance is therefore larger.
        lens: The numbers (6,) of the lens, as in ``LensTerms``; zeros if the lens is known.
        zeros: The offsets of the measured joints (dof,), rad or m.
        sigma: Standard deviations: across the ray and along it [m], tilt and turn [rad].
        kept: Whether each sample (n,) is not an outlier.
        covariance: The covariance of the six numbers of each pose, the scale, the lens, zeros,
            compliances and half plays.
        asked: Whether each parameter of the covariance was requested.
        free: Whether the samples determine each parameter; other parameters are unchanged.
    """

    bending: Bending
    extent: Extent
    T_camera_base: Matrix
    T_tip_board: Matrix
    scale: float
    lens: Vector
    zeros: Vector
    sigma: Vector
    kept: _Mask
    covariance: Matrix = field(repr=False)
    asked: _Mask = field(repr=False)
    free: _Mask = field(repr=False)

    def board_poses(self, q: Matrix) -> Matrix:
        """Compute the board's pose in the camera frame (n, 4, 4) at measured joints (n, dof)."""
        return self.T_camera_base @ self.tip_poses(q) @ self.T_tip_board

    def tip_poses(self, q: Matrix) -> Matrix:
        """Compute the tip's pose in the base frame (n, 4, 4) at measured joints (n, dof)."""
        chain = self.bending.dynamics.chain
        return chain.forward(self.bending.link_joints(np.atleast_2d(q) + self.zeros))

    def residuals(self, samples: Sequence[BoardSample]) -> Matrix:
        """Compute the deviations (n, 6) of boards from their predictions.

        Returns:
            Two columns across the ray and one along it [m], two for the tilt, one for the turn
            [rad].
        """
        predicted = self.board_poses(np.array([sample.q for sample in samples]))
        found: list[Vector] = []
        for T, sample in zip(predicted, samples, strict=True):
            seen = sample.T_camera_board
            at_m = (1.0 + self.scale) * seen[:3, 3]
            found.append(_residual(T, make_pose(at_m, seen[:3, :3]), _ray_frame(at_m))[0])
        return np.array(found)

    @property
    def parameters(self) -> tuple[FittedParameter, ...]:
        """The estimates of the requested arm parameters."""
        chain, n = self.bending.dynamics.chain, len(self.zeros)
        values = np.concatenate([self.zeros, self.bending.compliance, self.bending.half_play])
        deviations = np.sqrt(np.diag(self.covariance))[_POSES:]
        priors = _priors(self.bending)[_POSES:]
        unit = ["rad" if kind is JointType.REVOLUTE else "m" for kind in chain.kinds]
        moved = ["rad/N m" if each == "rad" else "m/N" for each in unit]
        named = [
            (f"{name} {what}", units[i])
            for what, units in (("zero", unit), ("compliance", moved), ("half backlash", unit))
            for i, name in enumerate(chain.names)
        ]
        return tuple(
            FittedParameter(*named[k], float(values[k]), float(deviations[k]), float(priors[k]))
            for k in range(3 * n)
            if self.asked[_POSES + k]
        )


@dataclass(frozen=True, slots=True, eq=False)
class CameraEstimate:
    """The fit that best predicts samples that were left out.

    Attributes:
        fit: The chosen fit, to all samples except outliers.
        arm_fit: The fit of all parameters except the backlash.
        left_out_m: The root mean square error across the ray, by extent, of samples left out one by
            one.
    """

    fit: CameraFit
    arm_fit: CameraFit
    left_out_m: dict[Extent, float]

    @property
    def before_m(self) -> float:
        """The error of left-out samples across the ray, with the arm as it was."""
        return self.left_out_m[Extent.CAMERA]

    @property
    def after_m(self) -> float:
        """The error of left-out samples across the ray, with the estimated arm."""
        return self.left_out_m[self.fit.extent]

    @property
    def zero_deviations(self) -> Vector:
        """Standard deviations of the zeros (dof,), rad or m, whether estimated or not."""
        fit = self.fit if self.fit.extent.zeros else self.arm_fit
        last = _POSES + len(fit.zeros)
        return np.sqrt(np.diag(fit.covariance))[_POSES:last]


_BETTER = 0.97  # more parameters are estimated only if that reduces the error by 3 %


def estimate_camera(
    known: Bending, samples: Sequence[BoardSample], extents: Sequence[Extent] = tuple(Extent)
) -> CameraEstimate:
    """Estimate the camera, the board, and the arm parameters that help to predict new samples.

    Args:
        known: The known arm with its masses, to which the board and other payload are added.
        samples: At least six samples, in different postures.
        extents: The parameters that may be estimated, `Extent.CAMERA` among them.

    Raises:
        CalibrationError: Too few samples, or they contradict each other.
    """
    if len(samples) < MIN_SAMPLES:
        raise CalibrationError(
            f"The board was seen in {len(samples)} pictures; at least {MIN_SAMPLES} are needed.",
            "Show the board in about 20 different postures, all over the picture.",
        )
    fullest = fit_camera(known, samples, Extent.ARM)
    found = {each: fit_camera(known, samples, each, fullest) for each in extents}
    error_m: dict[Extent, float] = {}
    for extent, fit in found.items():
        problem = _Problem(fit.bending, samples, fit.extent, fit.free)
        errors = problem.left_out(problem.state_of(fit), fit.sigma, fit.kept.astype(float))
        across = errors[fit.kept, :2]
        error_m[extent] = math.sqrt(float(np.sum(across**2)) / len(across))
    best = Extent.CAMERA
    for extent in extents:
        if error_m[extent] < _BETTER * error_m[best]:
            best = extent
    return CameraEstimate(found[best], fullest, error_m)


def fit_camera(
    known: Bending,
    samples: Sequence[BoardSample],
    extent: Extent,
    outliers_of: CameraFit | None = None,
) -> CameraFit:
    """Fit the camera, the board and the arm parameters of ``extent``.

    At least three samples are needed. The outliers of the fit ``outliers_of`` are left out; if it
    is None, outliers are searched for.

    Raises:
        CalibrationError: More than a third of the samples contradict the others.
    """
    problem = _Problem(known, samples, extent)
    kept = np.ones(len(samples), dtype=bool) if outliers_of is None else outliers_of.kept
    sigma = _START_SIGMA
    if outliers_of is None:
        state, kept = _without_outliers(problem, _first_state(problem))
    else:
        state = problem.start(outliers_of.T_camera_base, outliers_of.T_tip_board)
    weight = kept.astype(float)
    for is_last in (False, True):
        for _ in range(_ROUNDS):
            state = problem.minimise(state, sigma, weight)
            sigma = problem.deviations(state, sigma, weight)
        if not is_last:
            state = problem.leave_undetermined(state, sigma, weight)
    return problem.fit(problem.minimise(state, sigma, weight), sigma, kept)


def picture_information(fit: CameraFit, samples: Sequence[BoardSample]) -> tuple[Matrix, Matrix]:
    """Compute the information from boards (n) at expected poses on all parameters but backlash.

    Returns:
        The information matrix (k, k) of all pictures and the prior, and the rows (n, 12, k) of each
        picture, in standard deviations.
    """
    problem = _Problem(fit.bending, samples, Extent.ARM)
    return problem.information(problem.state_of(fit), fit.sigma)


def _without_outliers(problem: _Problem, state: _State) -> tuple[_State, _Mask]:
    """Return a fit to most samples, and a mask (n,) of the samples that it uses."""
    squares = problem.squares(state)
    typical = max(float(np.median(squares)), _EXPECTED)
    for power in (2.0,) * _ROUNDS + (1.0,) * _ROUNDS:  # outliers weigh little at first, then more
        weight = (1.0 + squares / (2.0 * typical)) ** -power
        state = problem.minimise(state, _START_SIGMA, weight)
        squares = problem.squares(state)
        typical = max(float(np.median(squares)), _EXPECTED)
    kept: _Mask = np.less(squares, _OUTLIER * typical)
    if typical > _IMPLAUSIBLE or np.count_nonzero(~kept) > _MAX_OUTLIER_FRACTION * len(kept):
        wrong = [s.name or str(i + 1) for i, s in enumerate(problem.samples) if not kept[i]]
        named = f"{len(wrong)} of {len(kept)}: {', '.join(wrong)}" if wrong else "most of them"
        raise CalibrationError(
            f"The pictures contradict each other ({named}).",
            "Is the board fixed firmly to the gripper, and does the camera stand still? "
            "Nothing was saved.",
        )
    return state, kept


@dataclass(frozen=True, slots=True, eq=False)
class _NormalEquations:
    """Second-order expansion of half the cost: value, slope (k,) and curvature (k, k)."""

    cost: float
    slope: Vector
    curvature: Matrix


class _Problem:
    """The least-squares problem of some samples."""

    def __init__(
        self,
        bending: Bending,
        samples: Sequence[BoardSample],
        extent: Extent,
        free: _Mask | None = None,
    ) -> None:
        self._bending, self.samples, self._extent = bending, samples, extent
        dof = bending.dynamics.chain.dof
        self._q = np.array([sample.q for sample in samples])
        self._lenses = [(i, each.lens) for i, each in enumerate(samples) if each.lens is not None]
        self.lens_at = self._lenses[0][1].at if self._lenses else np.zeros(6)
        wanted = (True, bool(self._lenses), extent.zeros, extent.bending,
                  extent is Extent.EVERYTHING)  # fmt: skip
        self._asked = np.repeat(np.array(wanted), [_POSES - 6, 6, dof, dof, dof])
        self._free = self._asked if free is None else free
        self._prior, self.dof = _priors(bending), dof
        self._known = np.concatenate([np.zeros(dof), bending.compliance, bending.half_play])
        self._distance = [float(np.linalg.norm(s.T_camera_board[:3, 3])) for s in samples]
        self._rays = [_ray_frame(sample.T_camera_board[:3, 3]) for sample in samples]
        self._noise = np.zeros((len(samples), 6, 6))
        for i, lens in self._lenses:
            both = np.kron(np.eye(2), self._rays[i])
            self._noise[i] = both @ lens.noise @ both.T

    def start(self, camera: Matrix, board: Matrix) -> _State:
        """Return the initial state with the known arm."""
        return _State(camera, board, 0.0, self.lens_at, self._known)

    def leave_undetermined(self, state: _State, sigma: Vector, weight: Vector) -> _State:
        """Keep the prior of undetermined parameters, the least determined first.

        If two parameters cannot be distinguished, one keeps its prior, and the other is then
        determined.
        """
        curvature = self._equations(state, sigma, weight).curvature
        free, most = self._free.copy(), _DETERMINED * self._prior
        most[_POSES + self.dof - 1] = _LAST_DETERMINED * self._prior[_POSES + self.dof - 1]
        while True:
            some = np.flatnonzero(free)
            deviation = np.sqrt(np.diag(np.linalg.inv(curvature[np.ix_(some, some)])))
            share = np.where(some < _POSES, 0.0, deviation / most[some])
            if share.max() < 1.0:
                break
            free[some[np.argmax(share)]] = False
        self._free = free
        return replace(state, arm=np.where(free[_POSES:], state.arm, self._known))

    def minimise(self, state: _State, sigma: Vector, weight: Vector) -> _State:
        """Return the state with the least sum of squares, found by Levenberg-Marquardt steps."""
        damping = 1e-6
        equations = self._equations(state, sigma, weight)
        for _ in range(_STEPS):
            free, bounded = self._free.copy(), slice(_POSES + self.dof, None)
            # Compliances and backlashes that are zero may not become negative.
            free[bounded] &= (state.arm[self.dof :] > 0.0) | (equations.slope[bounded] < 0.0)
            H = equations.curvature[np.ix_(free, free)]
            step = np.zeros(len(free))
            step[free] = np.linalg.solve(H + damping * np.diag(np.diag(H)), -equations.slope[free])
            tried = state.moved(step)
            tried.arm[self.dof :] = np.maximum(tried.arm[self.dof :], 0.0)
            reached = self._equations(tried, sigma, weight)
            if reached.cost > equations.cost:
                damping *= 10.0
                if damping > _MAX_DAMPING:
                    break
                continue
            done = equations.cost - reached.cost < _ENOUGH * (1.0 + abs(reached.cost))
            state, equations, damping = tried, reached, max(damping / 10.0, 1e-9)
            if done:
                break
        return state

    def deviations(self, state: _State, sigma: Vector, weight: Vector) -> Vector:
        """Estimate the standard deviations of the four components by leave-one-out prediction.

        For a sample far from all others, the residual is too small: the fit follows the sample.
        """
        noise = np.diagonal(self._noise, axis1=1, axis2=2)
        squares = self.left_out(state, sigma, weight) ** 2 - noise
        count, squares = float(np.sum(weight)), weight @ squares / _START_SIGMA[_COMPONENT] ** 2
        spread = np.array([np.mean(squares[np.equal(_COMPONENT, k)]) for k in range(4)]).clip(0.0)
        typical = max(float(np.mean(spread)) / count, _FINEST**2)
        return _START_SIGMA * np.sqrt((spread + _ASSUMED * typical) / (count + _ASSUMED))

    def fit(self, state: _State, sigma: Vector, kept: _Mask) -> CameraFit:
        """Return the fit at a state."""
        dof = self.dof
        curvature = self._equations(state, sigma, kept.astype(float)).curvature
        covariance, free = np.diag(self._prior**2), np.ix_(self._free, self._free)
        covariance[free] = np.linalg.inv(curvature[free])
        bending = self._bent(state)
        return CameraFit(
            bending, self._extent, state.camera, state.board, state.scale, state.lens,
            state.arm[:dof], sigma, kept, covariance, self._asked, self._free,
        )  # fmt: skip

    def left_out(self, state: _State, sigma: Vector, weight: Vector) -> Matrix:
        """Compute the residual (n, 6) of each sample at the fit to all other samples.

        The fit without a sample is one step from the fit with it; the leverage gives the step.
        """
        e, J = self._linearise(state)
        whiten = self._whiten(sigma)
        scaled = np.sqrt(weight)[:, None, None] * (whiten @ J[:, :, self._free])
        curvature = self._equations(state, sigma, weight).curvature
        inverse = np.linalg.inv(curvature[np.ix_(self._free, self._free)])
        leverage = scaled @ inverse @ scaled.swapaxes(1, 2)
        alone = np.linalg.solve(np.eye(6) - leverage, whiten @ e[:, :, None])
        return np.linalg.solve(whiten, alone)[:, :, 0].astype(np.float64)

    def _whiten(self, sigma: Vector) -> Matrix:
        """Return the matrices (n, 6, 6) that give each sample's residual unit covariance."""
        covariance = self._noise + np.diag(sigma[_COMPONENT] ** 2)
        return np.linalg.inv(np.linalg.cholesky(covariance)).astype(np.float64)

    @staticmethod
    def state_of(fit: CameraFit) -> _State:
        """Return the state of a fit."""
        arm = np.concatenate([fit.zeros, fit.bending.compliance, fit.bending.half_play])
        return _State(fit.T_camera_base, fit.T_tip_board, fit.scale, fit.lens, arm)

    def information(self, state: _State, sigma: Vector) -> tuple[Matrix, Matrix]:
        """Compute the curvature (k, k) of the cost, and each sample's rows (n, 12, k)."""
        J = self._whiten(sigma) @ self._linearise(state)[1]
        by_corners = np.zeros_like(J)
        for i, lens in self._lenses:
            values, vectors = np.linalg.eigh(lens.information)
            by_corners[i, :, 13:_POSES] = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        rows = np.concatenate([J, by_corners], axis=1)[:, :, self._free]
        prior = np.diag(1.0 / self._prior[self._free] ** 2)
        return prior + np.einsum("nik,nil->kl", rows, rows), rows

    def squares(self, state: _State) -> Vector:
        """Compute the squared residual (n,) of each sample, in units of the initial deviations."""
        e = self._linearise(state)[0]
        return np.sum((self._whiten(_START_SIGMA) @ e[:, :, None]) ** 2, axis=(1, 2))

    def tips(self) -> Matrix:
        """Return the tip poses (n, 4, 4) for the known arm."""
        return self._bending.dynamics.chain.forward(self._bending.link_joints(self._q))

    def _bent(self, state: _State) -> Bending:
        dof = self.dof
        return replace(
            self._bending, compliance=state.arm[dof : 2 * dof], half_play=state.arm[2 * dof :]
        )

    def _equations(self, state: _State, sigma: Vector, weight: Vector) -> _NormalEquations:
        e, J = self._linearise(state)
        whiten = np.sqrt(weight)[:, None, None] * self._whiten(sigma)
        rows, A = (whiten @ e[:, :, None]).ravel(), (whiten @ J).reshape(-1, len(self._free))
        moved = state.arm - self._known
        known = np.concatenate([np.zeros(12), [state.scale], state.lens, moved]) * self._free
        information = np.diag(1.0 / self._prior**2)
        slope = A.T @ rows + information @ known
        cost = float(rows @ rows + known @ information @ known)
        for i, lens in self._lenses:
            off, curved = state.lens - lens.at, weight[i] * lens.information
            slope[13:_POSES] += weight[i] * lens.slope + curved @ off
            information[13:_POSES, 13:_POSES] += curved
            cost += float(off @ curved @ off + 2.0 * weight[i] * (lens.slope @ off))
        return _NormalEquations(cost, slope, A.T @ A + information)

    def _linearise(self, state: _State) -> tuple[Matrix, Matrix]:
        """Compute the residuals (n, 6) and their derivatives (n, 6, 19 + 3 dof)."""
        n, dof = len(self._q), self.dof
        chain, bending = self._bending.dynamics.chain, self._bent(state)
        q = bending.link_joints(self._q + state.arm[:dof])
        e, J = np.empty((n, 6)), np.zeros((n, 6, _POSES + 3 * dof))
        T, J_tip = chain.forward_and_jacobian(q)
        by_joint = np.concatenate(bending.derivatives(q), axis=2)
        boards = state.camera @ T @ state.board
        for i, sample in enumerate(self.samples):
            turn = self._rays[i]
            e[i], inverse = _residual(boards[i], sample.T_camera_board, turn)
            point = boards[i, :3, 3]
            R_tip = state.camera[:3, :3] @ T[i, :3, :3]
            arm = T[i, :3, :3] @ state.board[:3, 3]
            motion = np.zeros((6, _POSES + 3 * dof))
            motion[:3, :3] = motion[3:, 3:6] = np.eye(3)
            motion[:3, 3:6] = -skew(point - state.camera[:3, 3])
            motion[:3, 6:9] = motion[3:, 9:12] = R_tip
            tip = J_tip[i].copy()
            tip[:3] -= skew(arm) @ tip[3:]
            motion[:3, _POSES:] = state.camera[:3, :3] @ tip[:3] @ by_joint[i]
            motion[3:, _POSES:] = state.camera[:3, :3] @ tip[3:] @ by_joint[i]
            J[i, :3] = turn @ motion[:3]
            J[i, 3:] = turn @ inverse @ motion[3:]
            J[i, 2, 12] = -self._distance[i]
            e[i, 2] -= state.scale * self._distance[i]
            if sample.lens is not None:
                by_lens = np.kron(np.eye(2), turn) @ sample.lens.by_lens
                J[i, :, 13:_POSES] = -by_lens
                e[i] -= by_lens @ (state.lens - sample.lens.at)
        return e, J


def _priors(bending: Bending) -> Vector:
    kinds = bending.dynamics.chain.kinds
    revolute = np.array([kind is JointType.REVOLUTE for kind in kinds])
    return np.concatenate(
        [
            np.full(12, _POSE),
            np.full(1, _SCALE),
            np.array(_LENS),
            np.where(revolute, _ZERO_RAD, _ZERO_M),
            np.where(revolute, _COMPLIANCE, _COMPLIANCE / 100.0),
            np.where(revolute, _HALF_PLAY_RAD, _HALF_PLAY_M),
        ]
    )


def _turned(T: Matrix, step: Vector) -> Matrix:
    """Return a pose shifted by (3,) and turned about its own origin by a rotation vector (3,).

    Both vectors are in the parent frame of the pose.
    """
    return make_pose(T[:3, 3] + step[:3], exp_so3(step[3:]) @ T[:3, :3])


def _residual(predicted: Matrix, seen: Matrix, turn: Matrix) -> tuple[Vector, Matrix]:
    """Return the residual (6,) in the ray frame, and the derivative (3, 3) of its rotation part."""
    phi = log_so3(predicted[:3, :3] @ seen[:3, :3].T)
    W = skew(phi)
    e = np.concatenate([turn @ (predicted[:3, 3] - seen[:3, 3]), turn @ phi])
    return e, np.eye(3) - 0.5 * W + W @ W / 12.0


def _ray_frame(point: Vector) -> Matrix:
    """Return R_ray_camera (3, 3), with the z axis towards a point (3,)."""
    z = point / max(float(np.linalg.norm(point)), 1e-9)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])


def _first_state(problem: _Problem) -> _State:
    """Return the best of several closed-form solutions, each from some of the samples."""
    tips, seen = problem.tips(), np.array([s.T_camera_board for s in problem.samples])
    chance, indices = np.random.default_rng(0), np.arange(len(tips))
    count = min(_START_SAMPLES, len(indices))
    chosen = [indices, *(chance.choice(indices, count, replace=False) for _ in range(_STARTS))]
    starts = [problem.start(*_closed_form(tips[some], seen[some])) for some in chosen]
    return min(starts, key=lambda start: float(np.median(problem.squares(start))))


def _closed_form(tips: Matrix, seen: Matrix) -> tuple[Matrix, Matrix]:
    """Compute the poses C and B (4, 4) that solve ``seen = C tips B``, rotations first.

    The rotations solve ``seen Bᵀ = C tips`` linearly in both (Shah, "Solving the robot-world/
    hand-eye calibration problem using the Kronecker product", 2013), then the positions follow.
    """
    eye = np.eye(3)
    rows: list[Matrix] = [
        np.hstack([_kron(eye, S[:3, :3]), -_kron(T[:3, :3].T, eye)])
        for T, S in zip(tips, seen, strict=True)
    ]
    null = np.linalg.svd(np.vstack(rows), full_matrices=False)[2][-1]
    both = null.reshape(2, 3, 3).swapaxes(1, 2)
    both *= np.sign(np.linalg.det(both[1])) or 1.0
    decomposed = [np.linalg.svd(each) for each in both]
    R_board_tip, R_camera = (  # the nearest rotations
        U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V for U, _, V in decomposed
    )
    A = np.vstack([np.hstack([R_camera @ T[:3, :3], eye]) for T in tips])
    b = np.concatenate([S[:3, 3] - R_camera @ T[:3, 3] for T, S in zip(tips, seen, strict=True)])
    at = np.linalg.lstsq(A, b, rcond=None)[0]
    return make_pose(at[3:], R_camera), make_pose(at[:3], R_board_tip.T)


def _kron(A: Matrix, B: Matrix) -> Matrix:
    return np.einsum("ij,kl->ikjl", A, B).reshape(9, 9)
