"""What the modules' settings may be, by the config's key for each module."""

from __future__ import annotations

from idapt_pl.ranges import COUNT_OR_NONE, NOT_NEGATIVE, POSITIVE, SHARE, Range

WIDTH = Range(1, 16384)
"""Of a layer."""
BATCH = Range(1, 1e6)
BELOW_ONE = Range(0, 1, "[)")
RATE = NOT_NEGATIVE
"""Of learning; 0 leaves things as they are."""

WEIGHTS = ("cycle", "identity", "state", "reset", "contrastive", "consistency")

MODULE_RANGES: dict[str, dict[str, Range]] = {
    "state_predictor": {"lr": RATE, "relight": Range(0, 3)},
    "visual": {
        "width": WIDTH, "blocks": Range(1, 100), "discriminator_width": WIDTH, "discriminator_layers": Range(1, 8),
        "pool_size": COUNT_OR_NONE, "state_jitter": NOT_NEGATIVE, "ema_decay": BELOW_ONE, "finetune_convs": Range(0, 4),
        "lr_generator": RATE, "lr_discriminator": RATE, "betas": BELOW_ONE, "images_every": Range(1, 1e9),
        **{f"{name}_weight": NOT_NEGATIVE for name in WEIGHTS},
    },
    "dynamics": {
        "hidden": WIDTH, "smoothing": SHARE, "residual_scale": POSITIVE, "lr": RATE, "lr_discriminator": RATE,
        "gamma": SHARE, "lam": SHARE, "clip": POSITIVE, "entropy_weight": NOT_NEGATIVE, "value_weight": NOT_NEGATIVE,
        "epochs": Range(1, 1e6), "batch_size": BATCH, "discriminator_batches": Range(1, 1e6),
        "gradient_penalty_weight": NOT_NEGATIVE, "initial_log_std": Range(-20, 5),
    },
    "policy": {
        "hidden": WIDTH, "lr": RATE, "lr_floor": SHARE, "gamma": SHARE, "tau": Range(0, 1, "(]"),
        "temperature": POSITIVE, "target_entropy": Range(-1e6, 1e6), "actor_every": Range(1, 1e6),
        "estimator_updates": Range(0, 1e6), "estimator_batch": BATCH, "lr_estimator": RATE,
        "misperception": NOT_NEGATIVE, "flicker": NOT_NEGATIVE, "relight": Range(0, 3), "memory": Range(0, 16384),
        "recurrent": Range(0, 16384), "sequence": Range(1, 10_000), "action_cost": NOT_NEGATIVE,
        "unfamiliarity_cost": NOT_NEGATIVE,
    },
}  # fmt: skip
"""Constructor arguments; those that are not here are no numbers."""
