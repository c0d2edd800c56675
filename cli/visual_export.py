"""``idapt visual export``: G as one file for deployment, PyTorch's (.pt2) or ONNX (.onnx)."""

from __future__ import annotations

from pathlib import Path

from cli.arguments import keep_inputs, parser
from idapt_pl.modules import VisualTransformation
from idapt_pl.modules.export import Translator, export_translator, largest_deviation

TOLERANCE = 2
"""Grey levels by which a file may differ from the module; more is an error."""


def main(args: list[str]) -> int:
    """Run ``idapt visual export``.

    Raises:
        RuntimeError: if the file would not give what the module gives; it is not kept.
    """
    p = parser("visual export", __doc__)
    p.add_argument("--run_dir", type=Path, default=Path("runs/visual"), help="run folder of `idapt visual fit`")
    p.add_argument("--ckpt_path", type=Path, help="checkpoint; default last.ckpt of the run folder")
    p.add_argument("--out", type=Path, required=True, help="file to write: .pt2 or .onnx")
    p.add_argument("--back", action="store_true", help="export the way back, from the target's look to the source's")
    o = p.parse_args(args)
    checkpoint = o.ckpt_path or o.run_dir / "last.ckpt"
    keep_inputs(o.out, [checkpoint])
    translator = Translator(VisualTransformation.from_checkpoint(checkpoint), o.back)
    export_translator(translator, o.out)
    if (difference := largest_deviation(translator, o.out)) > TOLERANCE:
        o.out.unlink()
        raise RuntimeError(f"{o.out} would differ from the module by {difference} grey levels; it was not kept")
    print(f"{o.out}: uint8 (n, {translator.frames}, H, W, 3) to the same; differs by at most {difference} of 255")
    return 0
