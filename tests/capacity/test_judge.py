from nmbg.capacity.judge import Limit, Score


def test_similarity_weighs_by_what_it_lacks() -> None:
    """The same loss of SSIM is little in a hard scene, and much in an easy one."""
    limit = Limit(0.1, 0.01)
    assert Score(20, 0.698).within(Score(20, 0.7), limit)
    assert not Score(30, 0.948).within(Score(30, 0.95), limit)
    assert not Score(29.8, 0.95).within(Score(30, 0.95), limit)
    assert Score(31, 0.96).within(Score(30, 0.95), Limit(0, 0))
