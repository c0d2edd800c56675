"""``idapt gallery``: a page with pictures of every task in every domain, and a table of what differs."""

from __future__ import annotations

from pathlib import Path

from cli.arguments import parser
from idapt_pl.files import write_atomically
from idapt_pl.gallery import page
from idapt_pl.tasks import TASKS, make_task


def main(args: list[str]) -> int:
    """Run ``idapt gallery``."""
    p = parser("gallery", __doc__)
    p.add_argument("--out", type=Path, required=True, help="folder to write index.html to")
    p.add_argument("--task", choices=TASKS, nargs="+", default=list(TASKS), help="tasks to show")
    p.add_argument("--image-size", type=int, default=200, help="side of the pictures, pixels")
    o = p.parse_args(args)
    text = page(map(make_task, o.task), o.image_size)
    path = o.out / "index.html"
    write_atomically(path, lambda temporary: temporary.write_text(text))
    print(path)
    return 0
