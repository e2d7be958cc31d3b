"""The summary of a batch."""

from getagrip.batch.clips import expected


def test_a_batch_is_summed_up_by_its_probabilities() -> None:
    assert expected({"a": 0.95, "b": 0.98}) == "about 2 of 2 are right in the hand, by their probabilities"
    assert expected({"a": 0.95}, "right in the camera").startswith("about 1 of 1 are right in the camera, by")
    text = expected({"a": 0.9, "b": 0.4, "c": 0.1, "d": 0.6})
    assert text.startswith("about 2 of 4 are right")
    assert text.endswith("the worst first: c, b")
