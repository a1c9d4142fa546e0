"""Two people who walk past each other, as MOTChallenge's files have true and detected boxes."""


def two_people(n_frames: int, one: tuple[int, int], other: tuple[int, int], across: int) -> tuple[str, str]:
    """Lines of truth and of detections: to the right from `one`, to the left from `other`, a pixel a frame.

    In each frame there is a false box with a low score, in the first `across` columns.
    """
    truth, detected = "", ""
    for number in range(1, n_frames + 1):
        for identity, (x, y) in enumerate(
            ((one[0] + number, one[1]), (other[0] - number, other[1])), start=1
        ):
            truth += f"{number},{identity},{x},{y},12,30,1,-1,-1,-1\n"
            detected += f"{number},-1,{x},{y},12,30,{20 + number % 3},-1,-1,-1\n"
        detected += (
            f"{number},-1,{1 + 37 * number % across},{1 + 53 * number % 60},9,9,{number % 7},-1,-1,-1\n"
        )
    return truth, detected
