"""Calls into code of others that may hang."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Any


class NoAnswer(TimeoutError):
    """Nothing came back in the time that was given."""


class Patient:
    """Calls functions in a thread of its own, always the same one, and waits for them for so long and no longer.

    Windows and contexts for drawing belong to a thread, so whatever uses them is to be made there too.
    """

    def __init__(self) -> None:
        self._calls: queue.SimpleQueue = queue.SimpleQueue()
        threading.Thread(target=self._work, daemon=True).start()  # daemon: what hangs must not keep the process

    def __call__(self, function: Callable[..., Any], *args: Any, seconds: float | None, **kwargs: Any) -> Any:
        """What a function returns, or its exception.

        Args:
            function: to call.
            args: of it.
            seconds: how long to wait; None for ever.
            kwargs: of it.

        Raises:
            NoAnswer: if it takes longer. It goes on, so this one must not be used any more.
        """
        answers: queue.SimpleQueue = queue.SimpleQueue()  # its own: an answer that nobody waited for is no other call's
        self._calls.put((function, args, kwargs, answers))
        try:
            result, error = answers.get(timeout=seconds)
        except queue.Empty:
            raise NoAnswer(f"no answer within {seconds:g} s") from None
        if error is not None:
            raise error
        return result

    def _work(self) -> None:
        while True:
            function, args, kwargs, answers = self._calls.get()
            try:
                answers.put((function(*args, **kwargs), None))
            except BaseException as error:
                answers.put((None, error))
