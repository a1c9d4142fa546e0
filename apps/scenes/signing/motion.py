"""Motion of a signer: hands from place to place, arms by inverse kinematics, a head that sways and turns."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....models.body.upper_body import BodyPoses, UpperBody, arm_at
from ....models.numerics.rotations import exponential
from ..random_fields import wander

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

TRIES = 40  # random targets of each move of a hand, of which the most natural possible one is used
MOVE = (0.25, 0.6)  # s, unless the way is too long for FASTEST
HOLD = (0.0, 0.4)  # s
REST = (0.4, 1.2)  # s, in the lap
FASTEST = 7.0  # head heights a second, about 25 px a frame
AHEAD = 4.0  # s beyond the scene for which the left arm is planned, for the right one to avoid
HEAD_TURN = np.array([0.18, 0.42, 0.13])  # largest nod, turn and tilt, rad


@dataclass(frozen=True)
class Habit:
    """A kind of target of a hand, in head heights from the point between the shoulders."""

    share: float  # how often
    across: tuple[float, float]  # range towards the hand's own side
    down: tuple[float, float]
    ahead: tuple[float, float]  # towards the viewer
    elbow: tuple[float, float]  # range of the elbow's depth below the shoulder, in upper arms


HABITS = (
    Habit(0.40, (0.0, 1.0), (0.1, 1.2), (0.7, 1.4), (0.5, 0.95)),  # in front of the chest
    Habit(0.15, (-0.35, 0.35), (-1.15, -0.5), (0.65, 1.1), (0.1, 0.9)),  # over the face
    Habit(0.13, (-1.0, -0.2), (0.0, 1.1), (0.7, 1.3), (0.3, 0.9)),  # over to the other side
    Habit(0.11, (0.0, 0.9), (-0.2, 0.7), (1.6, 2.5), (0.2, 0.8)),  # reaching towards the viewer
    Habit(0.13, (0.6, 1.6), (-0.9, 0.5), (0.4, 1.2), (-0.4, 0.4)),  # beside the shoulder, elbow raised
    Habit(0.08, (0.1, 0.5), (1.55, 1.85), (0.75, 1.2), (0.75, 1.0)),  # in the lap
)
LAP = len(HABITS) - 1
TOGETHER = 0.35  # of the right hand's moves begin with one of the left's
WAIT = 0.4  # s, at most, for the other hand
TO_OTHER_HAND = 0.15  # of its moves end near the left hand
PEAK = 1.875  # speed of a minimum-jerk move at its fastest, over its mean


def signing(
    body: UpperBody, home: Array, size: tuple[int, int], n_frames: int, dt: float, seed: int
) -> BodyPoses:
    """Generate poses of a signer whose root stays near `home` `(2,)` px, within `body`'s limits.

    The torso is upright and faces the camera. The first poses of a longer scene are those of a shorter one.
    """
    times = dt * np.arange(n_frames + int(np.ceil(2 * AHEAD / dt)), dtype=np.float64)
    generator = np.random.default_rng([seed, 10])
    height = body.head_height
    drift = np.stack([wander(times, (2.0, 9.0), generator) for _ in range(2)], axis=1)
    roots = home + height * np.array([0.09, 0.03]) * np.tanh(drift)
    turns = np.stack([wander(times, (1.2, 6.0), generator) for _ in range(3)], axis=1)
    necks = HEAD_TURN * np.tanh(0.8 * turns)
    planner = _Planner(body, roots, necks, size, dt)
    left = planner.plan(0, len(times) - int(AHEAD / dt), np.random.default_rng([seed, 11]), None)
    right = planner.plan(1, n_frames, np.random.default_rng([seed, 12]), left)
    arms = np.stack([left.arms[:n_frames], right.arms[:n_frames]], axis=1)
    return BodyPoses(roots[:n_frames], np.zeros((n_frames, 3)), necks[:n_frames], arms)


@dataclass(frozen=True, eq=False)
class _Plan:
    """Motion of one arm."""

    arms: Array  # `(n, 2, 3)`: directions of its segments in each frame
    joints: Array  # `(n, 2, 3)` px: elbow and hand from the point between the shoulders
    starts: list[float]  # s, of its moves
    ends: list[float]
    kinds: list[int]  # their habits


@dataclass(frozen=True)
class _Intent:
    """An intended move: its habit, start, duration and the pause after it (s)."""

    kind: int
    start: float
    duration: float
    pause: float
    to_other_hand: bool


@dataclass(frozen=True, eq=False)
class _Way:
    """A possible move: arms and joints as in `_Plan`, its end (s), and hand and swivel then."""

    arms: Array
    joints: Array
    end: float
    place: Array
    swivel: float


class _Planner:
    """Plans one arm after the other, move by move, as the best possible one of random ways."""

    def __init__(self, body: UpperBody, roots: Array, necks: Array, size: tuple[int, int], dt: float) -> None:
        self.body, self.roots, self.size, self.dt = body, roots, size, dt
        self.heads = exponential(necks) @ np.array([0.0, -body.neck, 0.0])

    def plan(self, side: int, n_frames: int, generator: np.random.Generator, other: _Plan | None) -> _Plan:
        """Plan the arm `side` for the first `n_frames` frames, out of the way of the `other` one."""
        longest = len(self.roots)
        plan = _Plan(np.zeros((longest, 2, 3)), np.zeros((longest, 2, 3)), [], [], [])
        place, swivel = self._beginning(side, generator)
        now, filled = 0.0, 0
        while filled < n_frames:
            intent = self._intent(now, generator, other)
            way = self._way(side, intent, filled, place, swivel, generator, other)
            if way is None:
                # try again a little later, and rest until then
                now += 0.1
                frames = np.arange(filled, min(longest, int(np.floor(now / self.dt)) + 1))
                held = np.broadcast_to(place, (1, len(frames), 3))
                arms, joints, _ = self._possible(side, held, np.full((1, len(frames)), swivel), frames, None)
                arms, joints = arms[0], joints[0]
            else:
                plan.starts.append(intent.start)
                plan.ends.append(way.end)
                plan.kinds.append(intent.kind)
                now = way.end + intent.pause
                place, swivel = way.place, way.swivel
                count = max(0, int(np.floor(now / self.dt)) + 1 - filled)
                arms, joints = way.arms[:count], way.joints[:count]
            plan.arms[filled : filled + len(arms)] = arms
            plan.joints[filled : filled + len(arms)] = joints
            filled += len(arms)
        return plan

    def _intent(self, now: float, generator: np.random.Generator, other: _Plan | None) -> _Intent:
        """Draw the next move of a hand that is free from `now` (s) on."""
        kind = int(generator.choice(len(HABITS), p=[habit.share for habit in HABITS]))
        start, duration = now, float(generator.uniform(*MOVE))
        pause = float(generator.uniform(*(REST if kind == LAP else HOLD)))
        if other is None:
            return _Intent(kind, start, duration, pause, False)
        if generator.random() < TOGETHER:
            following = int(np.searchsorted(other.starts, now))
            if following < len(other.starts) and other.starts[following] < now + WAIT:
                # both hands move together, often to the same kind of place
                start = other.starts[following]
                duration = other.ends[following] - start
                kind = other.kinds[following] if generator.random() < 0.7 else kind
        return _Intent(kind, start, duration, pause, bool(generator.random() < TO_OTHER_HAND))

    def _way(
        self,
        side: int,
        intent: _Intent,
        first: int,
        place: Array,
        swivel: float,
        generator: np.random.Generator,
        other: _Plan | None,
    ) -> _Way | None:
        """Return the most natural possible way from `place` and `swivel`, from frame `first` on."""
        targets, swivels, bows, wanted = self._ideas(side, HABITS[intent.kind], place, generator)
        if other is not None and intent.to_other_hand:
            arrival = min(int((intent.start + intent.duration) / self.dt), len(self.roots) - 1)
            spread = self.body.head_height * np.array([0.4, 0.4, 0.6])
            targets = other.joints[arrival, 1] + generator.uniform(-spread, spread, (TRIES, 3))
            targets -= self._shoulder(side)
        lengths = np.linalg.norm(targets - place, axis=1)
        durations = np.maximum(intent.duration, PEAK * lengths / (FASTEST * self.body.head_height))
        end = int(np.ceil((intent.start + durations.max() + intent.pause) / self.dt))
        frames = np.arange(first, min(len(self.roots), end + 1))
        phases = np.clip((frames * self.dt - intent.start) / durations[:, None], 0, 1)
        progress = phases**3 * (10 - 15 * phases + 6 * phases**2)  # minimum jerk
        ways = place + progress[..., None] * (targets - place)[:, None]
        ways += 4 * (progress * (1 - progress))[..., None] * bows[:, None]
        turned = swivel + progress * swivels[:, None]
        arms, joints, possible = self._possible(side, ways, turned, frames, other)
        misfit = np.abs(joints[:, -1, 0, 1] / self.body.upper_arm - wanted) + 0.25 * np.abs(swivels)
        best = int(np.argmin(np.where(possible, misfit, np.inf)))
        if not possible[best]:
            return None
        ends = intent.start + float(durations[best])
        return _Way(arms[best], joints[best], ends, targets[best], swivel + float(swivels[best]))

    def _beginning(self, side: int, generator: np.random.Generator) -> tuple[Array, float]:
        """Draw the first position of a hand from its shoulder (px), in front of the chest, and its swivel."""
        for _ in range(50):
            targets, _, _, wanted = self._ideas(side, HABITS[0], np.zeros(3), generator)
            swivels = generator.uniform(-np.pi, np.pi, TRIES)
            arms, reachable = arm_at(self.body, side, targets, swivels)
            usable = reachable & self._allowed(side, arms)
            if usable.any():
                misfit = np.abs(arms[:, 0, 1] - wanted)
                best = int(np.argmin(np.where(usable, misfit, np.inf)))
                return targets[best], float(swivels[best])
        raise ValueError(f"signer: no place in front of the chest can be reached by {self.body}")

    def _ideas(
        self, side: int, habit: Habit, place: Array, generator: np.random.Generator
    ) -> tuple[Array, Array, Array, Array]:
        """Draw targets (px from the shoulder), changes of swivel, bows of the way and depths of the elbow."""
        height, outwards = self.body.head_height, 1 - 2 * side
        low, high = np.array([habit.across, habit.down, habit.ahead]).T
        targets = generator.uniform(low, high, (TRIES, 3)) * np.array([outwards, 1.0, -1.0]) * height
        targets -= self._shoulder(side)
        swivels = generator.normal(0, 0.7, TRIES)
        lengths = np.linalg.norm(targets - place, axis=1)
        # ways are bent a little, mostly towards the viewer
        bows = generator.normal(0, 0.10, (TRIES, 3)) * lengths[:, None]
        bows[:, 2] -= 0.15 * lengths
        return targets, swivels, bows, generator.uniform(*habit.elbow, TRIES)

    def _shoulder(self, side: int) -> Array:
        return np.array([(0.5 - side) * self.body.shoulder_width, 0.0, 0.0])

    def _allowed(self, side: int, arms: Array) -> Mask:
        """Whether `arms` (n, 2, 3) of a side are within the body's limits, whatever the other arm does."""
        mirrored = arms * np.array([-1.0, 1.0, 1.0])
        both = np.stack([arms, mirrored] if side == 0 else [mirrored, arms], axis=1)
        n = len(arms)
        return self.body.allowed(BodyPoses(np.zeros((n, 2)), np.zeros((n, 3)), np.zeros((n, 3)), both))

    def _possible(
        self, side: int, way: Array, swivels: Array, frames: NDArray[np.int64], other: _Plan | None
    ) -> tuple[Array, Array, Mask]:
        """Arms and joints, (n, n_frames, 2, 3), on ways (n, n_frames, 3) of the hand; which are possible."""
        body, height, radius = self.body, self.body.head_height, self.body.hand
        n, m = way.shape[:2]
        flat, reachable = arm_at(body, side, way.reshape(-1, 3), swivels.reshape(-1))
        ok: Mask = (reachable & self._allowed(side, flat)).reshape(n, m)
        arms = flat.reshape(n, m, 2, 3)
        elbows = self._shoulder(side) + body.upper_arm * arms[:, :, 0]
        hands = elbows + body.forearm * arms[:, :, 1]
        # clear of the head: some points along the forearm against an ellipsoid with room for the arm's width
        room = np.array([body.head_width / 2, body.head_height / 2, 0.45 * height]) + 0.45 * radius
        for share in (0.0, 0.5, 0.8, 1.0):
            points = elbows + share * (hands - elbows)
            ok &= (((points - self.heads[frames]) / room) ** 2).sum(axis=2) > 1
        places = self.roots[frames] + hands[..., :2]
        margin = 0.6 * radius
        ok &= ((places > margin) & (places < np.array(self.size) - margin)).all(axis=2)
        ok[:, 1:] &= np.linalg.norm(np.diff(elbows, axis=1), axis=2) < 0.3 * height * 25 * self.dt
        if other is not None:
            theirs = other.joints[frames]
            ok &= np.linalg.norm(hands - theirs[:, 1], axis=2) > 1.1 * radius
            ok &= _gap(elbows, hands, theirs[:, 1]) > 0.9 * radius
            ok &= _gap(theirs[:, 0], theirs[:, 1], hands) > 0.9 * radius
        return arms, np.stack([elbows, hands], axis=2), np.asarray(ok.all(axis=1))


def _gap(starts: Array, ends: Array, points: Array) -> Array:
    """Distances of `points` from the segments between `starts` and `ends`, all `(..., 3)`."""
    along = ends - starts
    share = ((points - starts) * along).sum(axis=-1) / (along**2).sum(axis=-1)
    nearest = starts + np.clip(share, 0, 1)[..., None] * along
    gaps: Array = np.linalg.norm(points - nearest, axis=-1)
    return gaps
