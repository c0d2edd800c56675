"""Adam without hooks: the same bits as with them."""

import copy

import torch

from idapt_pl.modules.lean_adam import LeanAdam


def three_parameters():
    generator = torch.Generator().manual_seed(0)
    return [torch.nn.Parameter(torch.randn(n, 3, generator=generator)) for n in (4, 5, 6)]


def trained(kind, way, steps=6):
    """Parameters and the optimizer's state after steps whose last parameter has a gradient in every second one."""
    parameters, generator = three_parameters(), torch.Generator().manual_seed(1)
    optimizer = kind(parameters, lr=0.1, betas=(0.8, 0.99), eps=1e-6, fused=True)
    for i in range(steps):
        for p in parameters:
            p.grad = torch.randn(p.shape, generator=generator)
        if i % 2:
            parameters[-1].grad = None
        optimizer.param_groups[0]["lr"] = 0.1 / (i + 1)
        getattr(optimizer, way)()
    return parameters, optimizer


def test_an_update_is_a_step():
    (expected, of_steps), (found, of_updates) = trained(torch.optim.Adam, "step"), trained(LeanAdam, "update")
    for a, b, start in zip(expected, found, three_parameters(), strict=True):
        assert torch.equal(a, b)
        assert not torch.equal(a, start)
        assert all(torch.equal(of_steps.state[a][k], of_updates.state[b][k]) for k in ("step", "exp_avg", "exp_avg_sq"))


def test_it_goes_on_from_a_state_that_was_kept():
    found, optimizer = trained(LeanAdam, "update", steps=3)
    again = [torch.nn.Parameter(p.detach().clone()) for p in found]
    resumed = LeanAdam(again, lr=0.1, betas=(0.8, 0.99), eps=1e-6, fused=True)
    resumed.load_state_dict(copy.deepcopy(optimizer.state_dict()))
    for p, q in zip(found, again, strict=True):
        p.grad = torch.ones_like(p)
        q.grad = torch.ones_like(q)
    optimizer.step()
    resumed.update()
    assert all(torch.equal(p, q) for p, q in zip(found, again, strict=True))


def test_a_group_whose_gradients_come_later_moves_the_others_once():
    ends = []
    for kind, way in ((torch.optim.Adam, "step"), (LeanAdam, "update")):
        early, late = (torch.nn.Parameter(torch.ones(3)) for _ in range(2))
        optimizer = kind([{"params": [early]}, {"params": [late], "lr": 0.5}], lr=0.1, fused=True)
        for i in range(3):
            early.grad = torch.full((3,), i + 1.0)
            late.grad = torch.ones(3) if i else None
            getattr(optimizer, way)()
        ends.append(torch.cat([early, late]).detach())
    assert torch.equal(*ends) and (ends[0][3:] < 0.5).all()
