"""Stepwise selection adds until nothing helps and takes out what is needless."""

from idapt_pl.estimation.stepwise import backward_elimination, forward_selection


def add_largest(budget):
    """A step that adds the largest number left, if the sum stays within a budget; state: chosen, left, refused."""

    def step(state, taken):
        chosen, left, refused = state
        assert taken == len(chosen)
        new = max(left)
        if sum(chosen) + new > budget:
            return (chosen, left, new), False
        return ((*chosen, new), left - {new}, refused), True

    return step


def test_steps_are_taken_until_one_adds_nothing_and_what_it_says_is_kept():
    chosen, left, refused = forward_selection(((), {1, 2, 3, 4}, None), add_largest(8), 10)
    assert (chosen, left, refused) == ((4, 3), {1, 2}, 2)


def test_no_more_steps_are_taken_than_asked_for():
    assert forward_selection(((), {1, 2, 3, 4}, None), add_largest(100), 2)[0] == (4, 3)
    assert forward_selection(((), {1, 2}, None), add_largest(100), 0)[0] == ()


def drop_even(state, item):
    """Even numbers are needless."""
    assert item in state
    return tuple(i for i in state if i != item) if item % 2 == 0 else None


def test_needless_items_are_left_out_one_after_the_other():
    assert backward_elimination((1, 2, 3, 4), (1, 2, 3, 4), drop_even) == (1, 3)


def test_the_last_item_stays_and_is_not_even_tried():
    tried = []

    def drop(state, item):
        tried.append(item)
        return drop_even(state, item)

    assert backward_elimination((2, 4, 6), (2, 4, 6), drop) == (6,)
    assert tried == [2, 4]
    assert backward_elimination((2, 4, 6), (2, 4, 6), drop_even, least=0) == ()
    assert backward_elimination((2,), (2,), drop_even) == (2,)


def test_states_are_not_changed():
    state = (1, 2)
    assert backward_elimination(state, state, drop_even) == (1,)
    assert state == (1, 2)
