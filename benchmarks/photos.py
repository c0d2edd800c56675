"""Two small folders of photographs to try `idapt visual` on, made of one that matplotlib ships; nothing is downloaded.

    python benchmarks/photos.py PHOTOS

Writes PHOTOS/{trainA,trainB,testA,testB}: windows of 96x128 pixels. A is the photograph as it is, B the other half of
it in evening light (warm, darker, vignetted). The test windows of B are those of A in that light, so that translations
can be measured (--data.paired true).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import imageio.v3 as iio
import matplotlib.cbook
import numpy as np

HEIGHT, WIDTH = 96, 128
NUMBER = {"trainA": 120, "trainB": 120, "testA": 24, "testB": 24}


def evening(image: np.ndarray) -> np.ndarray:
    """A photograph in other light, uint8 (H, W, 3) to the same."""
    rows, columns = np.meshgrid(*(np.linspace(-1, 1, n) for n in image.shape[:2]), indexing="ij")
    light = np.array([1.0, 0.72, 0.5]) * (0.95 - 0.3 * (rows**2 + columns**2))[..., None]
    return (255 * (image / 255) ** 1.2 * light).round().astype(np.uint8)


def windows(photograph: np.ndarray, n: int, seed: int) -> list[np.ndarray]:
    """Random windows."""
    rng = np.random.default_rng(seed)
    corners = rng.integers(0, np.array(photograph.shape[:2]) - (HEIGHT, WIDTH) + 1, (n, 2))
    return [photograph[top : top + HEIGHT, left : left + WIDTH] for top, left in corners]


def main() -> None:
    """Write the folders."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("folder", type=Path)
    folder = p.parse_args().folder
    photograph = iio.imread(matplotlib.cbook.get_sample_data("grace_hopper.jpg", asfileobj=False))
    halves = {"trainA": photograph[:, :300], "trainB": photograph[:, 212:], "testA": photograph, "testB": photograph}
    for i, (name, n) in enumerate(NUMBER.items()):
        seed = 9 if name.startswith("test") else i
        (folder / name).mkdir(parents=True, exist_ok=True)
        for k, window in enumerate(windows(halves[name], n, seed)):
            iio.imwrite(folder / name / f"{k:03d}.png", evening(window) if name.endswith("B") else window)
    print(f"{sum(NUMBER.values())} images -> {folder}")


if __name__ == "__main__":
    main()
