"""``idapt gallery``: a page with pictures of every task in every domain, and a table of what differs.

With ``--run`` it also shows the source as the G of finished runs translates it.
"""

from __future__ import annotations

from pathlib import Path

from cli.arguments import add_task_options, parser
from idapt_pl.files import write_atomically
from idapt_pl.ranges import IMAGE_SIZE, check_ranges
from idapt_pl.report.gallery import LearnedTranslation, gallery_page
from idapt_pl.run import Run
from idapt_pl.tasks import SOURCES, TASKS, make_task


def main(args: list[str]) -> int:
    """Run ``idapt gallery``."""
    p = parser("gallery", __doc__)
    p.add_argument("--out", type=Path, required=True, help="folder to write index.html to")
    tasks = f"tasks to show: {', '.join(TASKS)}; {SOURCES}"
    p.add_argument("--task", nargs="+", default=list(TASKS), help=tasks)
    add_task_options(p)
    p.add_argument("--image-size", type=int, default=200, help="side of the pictures, pixels")
    p.add_argument("--run", type=Path, nargs="+", default=[], help="run folders whose G is shown too")
    o = p.parse_args(args)
    check_ranges("", {"--image-size": o.image_size}, {"--image-size": IMAGE_SIZE})
    if o.out.exists() and not o.out.is_dir():
        raise ValueError(f"{o.out}: --out is a file; name a folder")
    learned = [load_translation(run) for run in o.run]
    shown = [(g.task, g.target) for g in learned]
    if len(set(shown)) < len(shown):
        raise ValueError(f"--run: two runs have the same task and target ({shown}); give one of each")
    shown_tasks = [make_task(name, o.task_options if ":" in name else None) for name in o.task]
    text = gallery_page(shown_tasks, o.image_size, learned=learned)
    path = o.out / "index.html"
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    print(path)
    return 0


def load_translation(folder: Path) -> LearnedTranslation:
    """G of a run's last grounding step."""
    run = Run.open(folder)
    worlds, G = run.worlds, run.load_visual()
    return LearnedTranslation(worlds.task.name, worlds.target_domain.name, worlds.image_size, G.frames, G.translate)
