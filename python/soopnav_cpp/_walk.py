"""What a camera's increments over the ground add up to: a walk with its covariance."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["Walk"]

Array = npt.NDArray[np.float64]
_BRIDGE_MPS = 0.5  # what a gap may hide, beside moving on as before
_BRIDGE_RADPS = 0.5
_STALE_S = 1.0  # a speed older than this says nothing about a gap


def _turn(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


class Walk:
    """Poses x, y, heading that increments add up to.

    Increments are in axes of the previous body (x: image right, y: image up, turn counterclockwise from above). Each
    foot point's error, from the fit of its frame's plane, stands in two increments with opposite signs and cancels
    between all frames but the first and the last: the covariance of a pose is that of the tracks, summed, and of these
    two feet. Where an increment is missing the walk goes on at the speed it had, and the covariance says so.
    """

    def __init__(self) -> None:
        self._t_s: list[float] = []
        self._poses: list[Array] = []
        self._covariances: list[Array] = []
        self._feet: list[Array] = []
        self._start: Array | None = None
        self._speed: Array = np.zeros(3)
        self._speed_s = -math.inf
        self.since: list[int] = []  #: frame that each increment counts from; -1 where there is none
        self.bridged_s = 0.0  #: time that no measured increment covers

    def add(self, motion: Any, t_s: float) -> None:
        """The motion of the next frame (`PlanarMotion`)."""
        if not self._t_s:
            self._append(t_s, np.zeros(3), np.zeros((3, 3)), -1, np.zeros((2, 2)))
            return
        if not motion.dt_s > 0.0:
            dt_s = t_s - self._t_s[-1]
            usable = math.isfinite(dt_s) and dt_s > 0.0
            step = self._speed * dt_s if usable and t_s - self._speed_s < _STALE_S else np.zeros(3)
            self.bridged_s += dt_s if usable else 0.0
            hidden = np.array([_BRIDGE_MPS, _BRIDGE_MPS, _BRIDGE_RADPS]) * (dt_s if usable else 0.0)
            pose, covariance = self._moved(len(self._t_s) - 1, step, np.diag(hidden**2))
            self._append(t_s, pose, covariance, -1, self._feet[-1])
            return
        # The increment may span frames that could not be used: it counts from the frame that lies dt_s before.
        wanted = t_s - float(motion.dt_s)
        since = len(self._t_s) - 1
        while since > 0 and self._t_s[since] > wanted + 1e-6:
            since -= 1
        step = np.asarray(motion.increment, dtype=np.float64)
        if self._start is None:
            self._start = np.array(motion.foot_covariance_previous, dtype=np.float64)
        pose, covariance = self._moved(since, step, np.asarray(motion.track_covariance))
        dt_s = t_s - self._t_s[since]
        if motion.ok:
            self.bridged_s -= self._t_s[-1] - self._t_s[since]
        else:
            self.bridged_s += t_s - self._t_s[-1]
        if dt_s > 0.0:
            # In axes of the body at the end, which the next step starts from.
            self._speed = np.append(_turn(-step[2]) @ step[:2], step[2]) / dt_s
            self._speed_s = t_s
        self._append(t_s, pose, covariance, since if motion.ok else -1, np.asarray(motion.foot_covariance, np.float64))

    def _moved(self, since: int, step: Array, noise: Array) -> tuple[Array, Array]:
        pose, turn = self._poses[since], np.eye(3)
        turn[:2, :2] = _turn(pose[2])
        moved = turn @ step
        by_pose = np.eye(3)
        by_pose[:2, 2] = -moved[1], moved[0]
        covariance = by_pose @ self._covariances[since] @ by_pose.T + turn @ noise @ turn.T
        return pose + moved, covariance

    def _append(self, t_s: float, pose: Array, covariance: Array, since: int, foot: Array) -> None:
        self._t_s.append(t_s)
        self._poses.append(pose)
        self._covariances.append(covariance)
        self._feet.append(foot)
        self.since.append(since)

    def begin(self, k: int, pose: npt.ArrayLike) -> None:
        """Lay the whole walk so that frame `k` stands at this pose (x, y, heading)."""
        wanted, stands = np.asarray(pose, dtype=np.float64), self._poses[k].copy()
        turn = np.eye(3)
        turn[:2, :2] = _turn(wanted[2] - stands[2])
        self._poses = [turn @ (one - stands) + wanted for one in self._poses]
        self._covariances = [turn @ one @ turn.T for one in self._covariances]

    def __len__(self) -> int:
        return len(self._t_s)

    @property
    def last_s(self) -> float:
        """Time of the last frame."""
        return self._t_s[-1]

    @property
    def t_s(self) -> Array:
        """Times of the frames, shape (n,)."""
        return np.array(self._t_s)

    @property
    def pose(self) -> Array:
        """x, y [m] and heading [rad, not wrapped] of the body, shape (n, 3); starts at zero."""
        return np.array(self._poses).reshape(-1, 3)

    @property
    def covariance(self) -> Array:
        """Of the poses against the first one, shape (n, 3, 3) [m², m rad, rad²]."""
        found = np.array(self._covariances).reshape(-1, 3, 3)
        if self._start is None:
            return found
        begin = _turn(self._poses[0][2])
        first = begin @ self._start @ begin.T
        for k in range(1, len(found)):
            here = _turn(self._poses[k][2])
            found[k, :2, :2] += first + here @ self._feet[k] @ here.T
        return found

    @property
    def length_m(self) -> float:
        """Of the way over the ground."""
        return float(np.sum(np.hypot(*np.diff(self.pose[:, :2], axis=0).T))) if len(self) > 1 else 0.0
