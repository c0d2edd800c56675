"""Play a policy that `idapt export` wrote: needs onnxruntime, numpy and pillow, and nothing of idapt.

Fill in `get_image` and `send` and run it beside policy.onnx:  python play.py policy.onnx --seconds 10
"""

import argparse
import json
import time

import numpy as np
import onnxruntime
from PIL import Image


def get_image() -> np.ndarray:
    """What the robot's camera shows now: uint8 (height, width, 3), RGB, of any size. Fill this in."""
    raise SystemExit("play.py: fill in get_image() and send() for your robot, or try --dry-run")


def send(action: np.ndarray) -> None:
    """Tell the robot an action, in the units and order that `python play.py policy.onnx --about` prints."""
    raise SystemExit("play.py: fill in send() for your robot")


def resting() -> np.ndarray | None:
    """The action that leaves the robot as it stands, near which the first one is kept. None: it may be any."""
    return None


def stop() -> None:
    """Bring the robot to rest: called at the end, on Ctrl-C and on errors. Fill this in if its last command lasts."""


class PlayedPolicy:
    """Images in, actions out. `limit` is how much an action may change in a control step, as a share of its range.

    `begin` says from which action on.
    """

    def __init__(self, path: str, limit: float = 1.0) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        self.about = json.loads(self.session.get_modelmeta().custom_metadata_map["idapt"])
        self.low, self.high = (np.array(self.about[name], np.float32) for name in ("low", "high"))
        self.change = limit * (self.high - self.low)
        self.begin()

    def begin(self, last: np.ndarray | None = None) -> None:
        """Forget everything; call it when an episode begins, with the action that the robot is told now."""
        self.frames: list[np.ndarray] = []
        self.last = None if last is None else np.clip(np.asarray(last, np.float32), self.low, self.high)
        self.memory = np.zeros((1, self.about["memory"]), np.float32)

    def square(self, image: np.ndarray) -> np.ndarray:
        """The middle of an image, scaled to the size that the policy knows."""
        size = self.about["image_size"]
        height, width = image.shape[:2]
        scale = max(size / height, size / width)
        rows, columns = max(size, round(height * scale)), max(size, round(width * scale))
        if (rows, columns) != (height, width):
            image = np.array(Image.fromarray(image).resize((columns, rows), Image.Resampling.BICUBIC))
        top, left = (rows - size) // 2, (columns - size) // 2
        return image[top : top + size, left : left + size]

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """The action for a new image; call it once in each control step."""
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            raise ValueError(f"an image is {image.dtype} {image.shape}; expected uint8 (height, width, 3), RGB")
        frame = self.square(image)
        stack = self.frames or [frame] * self.about["frames"]  # the first image fills it
        self.frames = [*stack[1:], frame]
        inputs = {"pixels": np.stack(self.frames)[None], "memory": self.memory}
        known = {i.name for i in self.session.get_inputs()}
        action, self.memory = self.session.run(None, {k: v for k, v in inputs.items() if k in known})
        instead = (self.low + self.high) / 2 if self.last is None else self.last
        action = np.where(np.isfinite(action[0]), action[0], instead)
        if self.last is not None:
            action = np.clip(action, self.last - self.change, self.last + self.change)
        self.last = np.clip(action, self.low, self.high)
        return self.last


def main() -> None:
    """Play for some seconds, a control step at a time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("policy", help="the .onnx file")
    parser.add_argument("--seconds", type=float, default=10.0, help="how long to play")
    parser.add_argument("--limit", type=float, default=1.0, help="largest change of an action in a step, of its range")
    parser.add_argument("--about", action="store_true", help="print what the file says of itself, and stop")
    parser.add_argument("--dry-run", action="store_true", help="show it noise, send nothing, print what it would do")
    options = parser.parse_args()
    policy = PlayedPolicy(options.policy, options.limit)
    period = policy.about["period"]
    if options.about:
        print(json.dumps(policy.about, indent=2))
        return
    policy.begin(resting())
    if options.limit < 1 and policy.last is None:
        print("resting() says nothing, so the first action may be any: fill it in to bound that one too")
    try:
        play_steps(policy, period, max(1, round(options.seconds / period)), options.dry_run)
    except KeyboardInterrupt:
        raise SystemExit("stopped") from None
    finally:
        if not options.dry_run:
            stop()


def play_steps(policy: PlayedPolicy, period: float, steps: int, dry_run: bool) -> None:
    """So many control steps at a fixed rate."""
    rng, late, begin = np.random.default_rng(0), 0, time.monotonic()
    for step in range(steps):
        image = rng.integers(0, 256, (120, 160, 3), np.uint8) if dry_run else get_image()
        action = policy(image)
        print(f"{step:6d}  {np.round(action, 4).tolist()}") if dry_run else send(action)
        left = begin + (step + 1) * period - time.monotonic()
        late += left < 0
        time.sleep(max(0.0, left))
    print(f"{steps} control steps of {period:g} s, {late} of them late")


if __name__ == "__main__":
    main()
