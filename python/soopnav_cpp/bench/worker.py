"""One peer in an interpreter of its own: reads commands and writes answers, a JSON object per line.

Run by path with the path of the peer's module, the name of its function, and an NPZ file of its data. Writes
``{"ready": true}`` or ``{"error": "..."}``; then answers each line it reads:
``{"do": "answer"}`` with ``{"answer": [...]}`` and ``{"do": "time"}`` with ``{"s": seconds}``. Ends with its input.
It needs NumPy and the peer, nothing of soopnav.
"""

from __future__ import annotations

import gc
import importlib.util
import json
import os
import sys
import time
from pathlib import Path

import numpy as np


def main(module_path: str, function: str, data_path: str) -> None:
    """Prepare the peer, then obey."""
    # What a package prints must not get among the answers.
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)

    def say(**answer: object) -> None:
        answers.write(json.dumps(answer) + "\n")

    try:
        spec = importlib.util.spec_from_file_location(Path(module_path).stem, module_path)
        if spec is None or spec.loader is None:
            raise ImportError(f"{module_path}: no module")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        with np.load(data_path) as file:
            run, answer = getattr(module, function)({name: file[name] for name in file.files})
        say(ready=True)
        for line in sys.stdin:
            command = json.loads(line)["do"]
            if command == "answer":
                say(answer=[float(value) for value in answer(run())])
            else:
                gc.collect()
                gc.disable()
                start = time.perf_counter()
                run()
                elapsed = time.perf_counter() - start
                gc.enable()
                say(s=elapsed)
    except Exception as error:
        say(error=f"{type(error).__name__}: {error}")


if __name__ == "__main__":
    main(*sys.argv[1:])
