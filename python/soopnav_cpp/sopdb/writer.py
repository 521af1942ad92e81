"""Writes one after the other, several in each transaction.

A commit waits for the disk; those who wait meanwhile share the next one (group commit). Each job has its own savepoint,
so one that fails takes nothing of the others with it, and nobody is answered before the commit.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from sqlalchemy import Engine
from sqlalchemy import exc as _errors
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from soopnav_cpp.sopdb.database import DatabaseUnavailableError, lock_for_writing

__all__ = ["BusyError", "Writer"]

_T = TypeVar("_T")
_Job = tuple[Callable[[Session], Any], "Future[Any]"]
#: The database itself is locked, full or gone: each job alone would wait as long, and fail as well.
_OF_ALL = (_errors.OperationalError, _errors.InterfaceError, _errors.TimeoutError)


class BusyError(RuntimeError):
    """More writes wait than can be made in time."""


class Writer:
    """The thread that writes.

    Parameters
    ----------
    engine : Engine
    waiting : int
        Jobs that may wait; one more is refused.
    together : int
        Jobs of one transaction, so that its end is not far.
    undone : callable, optional
        Called in the writer's thread whenever something that a job did was taken back: row ids are given again.
    """

    def __init__(
        self, engine: Engine, *, waiting: int = 2000, together: int = 32, undone: Callable[[], Any] | None = None
    ) -> None:
        self._engine = engine.execution_options(writes=True)
        self._together = together
        self._undone = undone or (lambda: None)
        self._queue: queue.Queue[_Job | None] = queue.Queue(waiting)
        self._closing = threading.Lock()
        self._closed = False
        self.commits = 0
        self._thread = threading.Thread(target=self._run, name="sopdb-writer", daemon=True)
        self._thread.start()

    def submit(self, job: Callable[[Session], _T]) -> Future[_T]:
        """Have `job` done in a transaction; its future is set once that is committed.

        Raises
        ------
        BusyError
            When too many wait, or after `close`.
        """
        future: Future[_T] = Future()
        with self._closing:
            if self._closed:
                raise BusyError("the database is being closed")
            try:
                self._queue.put_nowait((job, future))
            except queue.Full:
                raise BusyError("too many writes are waiting") from None
        return future

    def close(self) -> None:
        """Do what waits, and end."""
        with self._closing:
            if self._closed:
                return
            self._closed = True
        self._queue.put(None)
        self._thread.join()

    def _run(self) -> None:
        while True:
            first = self._queue.get()
            batch: list[_Job] = []
            last = first is None
            if first is not None:
                batch.append(first)
            while not last and len(batch) < self._together:
                try:
                    item = self._queue.get_nowait()
                except queue.Empty:
                    break
                if item is None:
                    last = True
                else:
                    batch.append(item)
            batch = [one for one in batch if one[1].set_running_or_notify_cancel()]
            if batch:
                self._write(batch)
            if last:
                return

    def _write(self, batch: list[_Job]) -> None:
        outcomes: list[tuple[Any, Exception | None]] = []
        try:
            with Session(self._engine) as session, session.begin():
                lock_for_writing(session.connection())
                for job, _ in batch:
                    try:
                        with session.begin_nested():
                            outcomes.append((job(session), None))
                    except SQLAlchemyError:
                        raise
                    except Exception as error:  # its own, told to who asked
                        self._undone()
                        outcomes.append((None, error))
        except Exception as error:
            self._undone()
            # One that the database refuses takes nobody with it.
            if len(batch) > 1 and not isinstance(error, _OF_ALL):
                for one in batch:
                    self._write([one])
                return
            refusal = DatabaseUnavailableError("the database did not take the write")
            refusal.__cause__ = error
            for _, future in batch:
                future.set_exception(refusal)
            return
        self.commits += 1
        for (_, future), (result, failure) in zip(batch, outcomes, strict=True):
            if failure is None:
                future.set_result(result)
            else:
                future.set_exception(failure)
