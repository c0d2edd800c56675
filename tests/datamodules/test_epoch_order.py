"""The order of an epoch depends on the epoch alone."""

from datamodules.epoch_order import EpochOrder


def test_every_epoch_and_pass_has_its_own_order_of_all():
    order, seen = EpochOrder(20, 3), []
    for epoch in range(3):
        order.set_epoch(epoch)
        seen += [tuple(order), tuple(order)]
    assert all(sorted(s) == list(range(20)) for s in seen) and len(set(seen)) == 6


def test_an_epoch_that_is_gone_on_from_has_the_order_it_would_have_had():
    whole, resumed = EpochOrder(20, 3), EpochOrder(20, 3, epoch=2)
    list(whole)
    whole.set_epoch(2)
    expected = [list(whole), list(whole)]
    first = list(resumed)
    resumed.set_epoch(2)
    assert [first, list(resumed)] == expected
    assert list(EpochOrder(20, 4, epoch=2)) != expected[0], "another seed, another order"
