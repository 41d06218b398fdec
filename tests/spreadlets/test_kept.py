"""What is kept for the next camera."""

from spreadlets.kept import Kept


def doubled(keys):
    return [2 * key for key in keys]


def test_the_oldest_go_when_there_is_too_much():
    kept, made = Kept(most=3, size=lambda _: 1), []

    def make(keys):
        made.extend(keys)
        return doubled(keys)

    assert kept.of([1, 2, 3], make) == [2, 4, 6]
    assert kept.of([4, 3], make) == [8, 6]
    assert kept.of([2, 3, 4], make) == [4, 6, 8] and made == [1, 2, 3, 4]
    assert kept.of([1], make) == [2] and made[-1] == 1


def test_more_than_is_kept_is_returned_all_the_same():
    kept = Kept(most=2, size=lambda _: 1)
    for _ in range(2):
        assert kept.of(range(5), doubled) == [0, 2, 4, 6, 8]
