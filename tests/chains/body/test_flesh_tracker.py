"""Tracks of head and hands: against filterpy, van Loan's integral and enumeration, and in made-up scenes."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray
from rsmcm.chains.body.flesh_assignment import MovingParts
from rsmcm.chains.body.flesh_state import HANDS, HEAD, LEFT, RIGHT, FleshTracks
from rsmcm.chains.body.flesh_tracker import FleshTracker
from rsmcm.inference import Incoming
from rsmcm.models.body.image_features import BodyImage
from rsmcm.models.body.parts import BodyParts, PartMessage
from rsmcm.models.body.upper_body import UpperBody
from rsmcm.models.core.frame import Frame
from rsmcm.models.core.gaussian_mixtures import NO_LABEL, GaussianMixtures
from scipy.linalg import expm

Array = NDArray[np.float64]

SEEDS = st.integers(0, 2**32 - 1)
DT = 0.04
HEIGHT = 90.0
"""px of the head, the unit of length in what follows."""
BODY = UpperBody.from_head(HEIGHT)
TRACKER = FleshTracker(BODY)
IMAGE = np.zeros((360, 640, 3), np.uint8)
FIRST = Frame(IMAGE, 0.0, 1)
CENTRE = np.array([320.0, 110.0])
NOISE = 0.06 * HEIGHT
FOUND = 0.8
CLUTTER = 2.0
"""Blobs that are nothing, in an image."""


def at(*heads: Sequence[float]) -> Array:
    """Places px, given in head heights from where the head usually is."""
    return CENTRE + HEIGHT * np.asarray(heads, np.float64).reshape(-1, 2)


def picture(mixtures: GaussianMixtures) -> PartMessage:
    """An image that says this of parts, and nothing else that the tracker asks for."""
    flat = np.zeros(IMAGE.shape[:2], np.float32)
    image = BodyImage(flat.shape, None, None, flat, flat, np.zeros((0, 2)), np.zeros(0), mixtures)
    return PartMessage(GaussianMixtures.uniform(3), image)


def seen(
    places: ArrayLike, noise: float = NOISE, flat: bool = True, faces: Sequence[int] = ()
) -> PartMessage:
    """What an image says in which there are blobs in these places, some of which are surely faces.

    A blob is a part that was found, or one of the pieces of clutter, which are anywhere.
    """
    blobs = np.asarray(places, np.float64).reshape(-1, 2)
    count = len(blobs)
    is_face = np.isin(np.arange(count), faces)
    ratio = np.log(FOUND * IMAGE[..., 0].size / CLUTTER)
    weights = [ratio + np.where(is_face, 2.0, -2.0), *[ratio - 2.0 * is_face] * 2]
    lost = np.log(1 - FOUND) if flat else -np.inf
    return picture(
        GaussianMixtures.of_parts(
            weights,
            [blobs] * 3,
            [np.tile(NOISE**2 * np.eye(2), (count, 1, 1))] * 3,
            [lost] * 3,
            [np.arange(count)] * 3,
        )
    )


def told(*places: Sequence[float], spread: float = 0.2) -> PartMessage:
    """What another chain says of all parts."""
    means = at(*places)
    return PartMessage(
        GaussianMixtures.of_parts(
            [[0.0]] * 3, list(means[:, None]), [((spread * HEIGHT) ** 2 * np.eye(2))[None]] * 3
        )
    )


def updated(state: FleshTracks, message: PartMessage, tracker: FleshTracker = TRACKER) -> FleshTracks:
    return tracker.update(state, Incoming({BodyParts(HEIGHT): message}))


def stepped(state: FleshTracks, message: PartMessage, tracker: FleshTracker = TRACKER) -> FleshTracks:
    return updated(tracker.predict(state, DT), message, tracker)


def followed(
    looks: Sequence[PartMessage], state: FleshTracks | None = None, tracker: FleshTracker = TRACKER
) -> list[FleshTracks]:
    """States after each look."""
    states = []
    for look in looks:
        state = (
            updated(tracker.initial(FIRST), look, tracker) if state is None else stepped(state, look, tracker)
        )
        states.append(state)
    return states


REST = at((0, 0), (0.8, 1.6), (-0.8, 1.6))
"""Head, left hand, right hand of somebody who stands there."""


def standing(frames: int = 10) -> FleshTracks:
    """After some frames of that."""
    return followed([seen(REST, faces=[0])] * frames)[-1]


def off(state: FleshTracks, places: ArrayLike) -> Array:
    """`(3,)` head heights between parts and where they should be."""
    distances: Array = np.linalg.norm(state.positions - np.asarray(places), axis=1) / HEIGHT
    return distances


def exchanged(state: FleshTracks, places: Array) -> float:
    """Probability of the hypotheses in which each hand is nearer to where the other one should be."""
    kept, other = (
        np.linalg.norm(state.means[..., :2] - each, axis=2).sum(axis=1)
        for each in (places, places[[HEAD, RIGHT, LEFT]])
    )
    return float(state.weights[other < kept].sum())


# --- how parts move ---


def matrices(dt: float, speed: float, lasts: float) -> tuple[Array, Array]:
    """Transition and noise of an Ornstein-Uhlenbeck velocity and its integral, by van Loan's exponential."""
    drift = np.kron([[0, 1], [0, -1 / lasts]], np.eye(2))
    pushes = np.kron([[0, 0], [0, 2 * speed**2 / lasts]], np.eye(2))
    whole = expm(dt * np.block([[-drift, pushes], [np.zeros((4, 4)), drift.T]]))
    move = whole[4:, 4:].T
    return move, move @ whole[:4, 4:]


@pytest.mark.parametrize("dt", [1e-5, 2.9e-4, 3.1e-4, 0.04, 1.0])
def test_motion_is_van_loans(dt: float) -> None:
    speeds, lasts = np.array([50.0, 200.0, 300.0]), 0.3
    root = np.random.default_rng(0).normal(0, 3, (3, 4, 4))
    parts = MovingParts(np.arange(12.0).reshape(3, 4), root @ root.swapaxes(1, 2) + np.eye(4))
    after = parts.predict(dt, speeds, lasts)
    still = MovingParts(np.zeros((3, 4)), np.zeros((3, 4, 4))).predict(dt, speeds, lasts)
    for part, speed in enumerate(speeds):
        move, noise = matrices(dt, speed, lasts)
        np.testing.assert_allclose(after.means[part], move @ parts.means[part], rtol=1e-10)
        expected = move @ parts.covariances[part] @ move.T + noise
        np.testing.assert_allclose(after.covariances[part], expected, rtol=1e-9, atol=1e-9)
        if dt > 1e-3:  # below, van Loan's own product loses its digits
            np.testing.assert_allclose(still.covariances[part], noise, rtol=1e-9, atol=1e-9)


def test_clean_single_detections_are_filterpys_up_to_the_doubt() -> None:
    """What remains is a jump to anywhere, which hardly ever explains a detection better."""
    sure = FleshTracker(BODY, max_coast_time=1e9)
    state = standing().take(np.array([0]))
    state = replace(state, log_weights=np.zeros(1), max_coast_time=sure.max_coast_time)
    speeds = HEIGHT * np.array([sure.head_speed, sure.hand_speed, sure.hand_speed])
    oracles = []
    for part, speed in enumerate(speeds):
        oracle = KalmanFilter(dim_x=4, dim_z=2)
        oracle.x, oracle.P, oracle.H = state.means[0, part].copy(), state.covariances[0, part], np.eye(2, 4)
        oracle.F, oracle.Q = matrices(DT, speed, sure.velocity_time)
        oracles.append(oracle)
    random = np.random.default_rng(2)
    for _ in range(30):
        looks = REST + random.normal(0, 0.5 * NOISE, (3, 2))  # a rare one would be taken for a jump
        state = stepped(state, seen(looks, flat=False, faces=[0]), sure)
        for part, oracle in enumerate(oracles):
            oracle.predict()
            oracle.update(looks[part], R=NOISE**2 * np.eye(2))
            np.testing.assert_allclose(state.positions[part], oracle.x[:2], atol=1e-3)
            np.testing.assert_allclose(state.covariances[0, part], oracle.P, rtol=1e-4, atol=1e-2)


# --- which thing is which part ---


def test_a_hand_that_is_not_seen_does_not_jump_onto_the_other_one() -> None:
    states = followed([seen(REST[:2], faces=[0])] * 15, standing())
    assert all(state.labels[RIGHT] == NO_LABEL for state in states)
    assert off(states[-1], REST)[LEFT] < 0.1


def test_hands_that_met_may_be_exchanged_until_somebody_knows() -> None:
    """They come together, rest as one blob, and part up and down: nobody can tell which is which."""
    coming = [seen([CENTRE, *at((x, 1.6), (-x, 1.6))], faces=[0]) for x in np.linspace(0.8, 0.25, 8)]
    one = [seen([CENTRE, at((0.0, 1.6))[0]], faces=[0])] * 12
    ways = [at((0.0, 1.6 - y), (0.0, 1.6 + y)) for y in np.linspace(0.3, 1.0, 8)]
    states = followed([*coming, *one, *[seen([CENTRE, *way], faces=[0]) for way in ways]], standing())
    assert exchanged(states[7], REST) < 0.01
    last = states[-1]
    upper_left = np.stack([CENTRE, *ways[-1]])
    assert 0.2 < exchanged(last, upper_left) < 0.8
    message = TRACKER.message(last, BodyParts(HEIGHT), Incoming({}))
    both = message.log_values(np.stack([upper_left, upper_left[[HEAD, RIGHT, LEFT]]]))
    assert np.abs(both[0] - both[1]) < 2
    for upper, lower in ((LEFT, RIGHT), (RIGHT, LEFT)):
        truth = [(0.0, 0.0)] * 3
        truth[upper], truth[lower] = (0.0, 0.6), (0.0, 2.6)
        knowing = told(*truth, spread=0.4)
        after = stepped(last, seen([CENTRE, *ways[-1]], faces=[0]) * knowing)
        assert after.positions[upper, 1] < after.positions[lower, 1]
        assert exchanged(after, at(*truth)) < 0.05
        assert off(after, at(*truth)).max() < 0.15


# --- what is wrong or missing ---


def test_an_outlier_does_not_move_a_part() -> None:
    state = TRACKER.predict(standing(), DT)
    deviation = np.sqrt(state.position_covariances[LEFT, 0, 0] + NOISE**2)
    wrong = REST[LEFT] + [10 * deviation, 0.0]
    after = updated(state, seen([CENTRE, wrong, REST[RIGHT]], faces=[0]))
    assert np.linalg.norm(after.positions - state.positions, axis=1)[LEFT] < 0.1 * deviation
    beside = updated(state, seen([CENTRE, REST[LEFT], REST[RIGHT], wrong], faces=[0]))
    assert off(beside, REST).max() < 0.02
    near = updated(state, seen([CENTRE, REST[LEFT] + [deviation, 0.0], REST[RIGHT]], faces=[0]))
    assert near.positions[LEFT, 0] - state.positions[LEFT, 0] > 0.2 * deviation


def test_a_lost_part_is_anywhere_in_reach_and_found_again() -> None:
    states = followed([seen(REST[[HEAD, RIGHT]], faces=[0])] * 100, standing())
    state = states[-1]
    np.testing.assert_array_equal(state.lost, [False, True, False])
    reach = 0.5 * (BODY.upper_arm + BODY.forearm)
    deviations = np.sqrt(np.diagonal(state.position_covariances[LEFT]))
    assert ((deviations > 0.9 * reach) & (deviations < 1.4 * reach)).all()  # the head may be elsewhere, too
    back = np.stack([CENTRE, *at((0.6, -0.6), (-0.8, 1.6))])
    after = followed([seen(back, faces=[0])] * 6, state)
    assert off(after[-1], back).max() < 0.1
    assert not after[-1].lost.any()


def test_at_first_left_is_left() -> None:
    """Of two hands nobody knows more at first than that most people do not cross their arms."""
    state = followed([seen(REST, faces=[0])] * 2)[-1]
    assert off(state, REST).max() < 0.1
    assert 1e-4 < exchanged(state, REST) < 0.5


@given(SEEDS)
@settings(max_examples=8, deadline=None)
def test_nothing_said_leaves_the_prediction(seed: int) -> None:
    state = TRACKER.predict(standing(), DT)
    random = np.random.default_rng(seed)
    nothing = picture(GaussianMixtures.of_parts([[]] * 3, [[]] * 3, [[]] * 3, random.normal(0, 1, 3)))
    after = updated(state, nothing)
    for name in ("means", "covariances", "since", "visible", "log_weights", "elapsed"):
        np.testing.assert_array_equal(getattr(after, name), getattr(state, name))


def test_what_others_say_is_not_followed_itself() -> None:
    """Without anything in the picture parts coast, or others' echo of the same pictures made them surer."""
    state = standing()
    coasting = followed([seen(np.zeros((0, 2)))] * 10, state)[-1]
    place = [(0.1, 0.0), (1.1, 1.5), (-0.8, 1.7)]
    hearing = followed([seen(np.zeros((0, 2))) * told(*place)] * 10, state)[-1]
    np.testing.assert_allclose(hearing.means[0], coasting.means[0], atol=1e-6)
    np.testing.assert_allclose(hearing.covariances[0], coasting.covariances[0], rtol=1e-6)
    np.testing.assert_allclose(hearing.unseen, 10 * DT)


# --- what any filter must keep ---


def random_look(random: np.random.Generator) -> PartMessage:
    """Blobs anywhere, with covariances of any size."""
    count = random.integers(0, 7)
    roots = random.normal(0, 1, (count, 2, 2)) * 10.0 ** random.uniform(-2, 2, (count, 1, 1))
    covariances = roots @ roots.swapaxes(1, 2) + 1e-4 * np.eye(2)
    blobs = random.uniform((-50, -50), (700, 400), (count, 2))
    return picture(
        GaussianMixtures.of_parts(
            random.normal(5, 5, (3, count)),
            [blobs] * 3,
            [covariances] * 3,
            np.where(random.random(3) < 0.8, random.normal(-2, 2, 3), -np.inf if count else 0.0),
            [np.arange(count)] * 3,
        )
    )


@given(SEEDS)
@settings(max_examples=15, deadline=None)
def test_covariances_stay_positive_definite_and_messages_integrate_to_one(seed: int) -> None:
    random = np.random.default_rng(seed)
    state = TRACKER.initial(FIRST)
    for _ in range(8):
        state = updated(TRACKER.predict(state, 10.0 ** random.uniform(-3, 1)), random_look(random))
        assert (np.linalg.eigvalsh(state.covariances) > 0).all()
        np.testing.assert_array_equal(state.covariances, state.covariances.swapaxes(2, 3))
        assert ((state.visible >= 0) & (state.visible <= 1)).all()
        assert ((state.clutter.existence >= 0) & (state.clutter.existence < 1)).all()
        assert state.weights.sum() == pytest.approx(1, abs=1e-9)
        message = TRACKER.message(state, BodyParts(HEIGHT), Incoming({}))
        assert message.log_mass == pytest.approx(0, abs=1e-5)


def test_of_bare_arms_the_head_is_told_but_no_hand() -> None:
    """Messages about hands are those of lost ones; with half a probability, they say half as much."""
    state = TRACKER.predict(followed([seen(REST, faces=[0])] * 10, standing())[-1], DT)
    peaks = [
        np.exp(
            TRACKER.message(state, BodyParts(HEIGHT, bare=bare), Incoming({})).predicted.log_values(
                REST[None]
            )
        )[0]
        for bare in (0.0, 0.5, 1.0)
    ]
    sleeves, either, bare = peaks
    assert bare[HEAD] == pytest.approx(sleeves[HEAD], rel=1e-4)
    assert (bare[HANDS] < 0.1 * sleeves[HANDS]).all()
    np.testing.assert_allclose(either[HANDS], 0.5 * (sleeves + bare)[HANDS], rtol=1e-4)


# --- in an engine ---


def near(places: Array) -> FleshTracks:
    """Somebody who was seen there just now."""
    return followed([seen(places, faces=[0])] * 3)[-1]
