# SPDX-License-Identifier: BSD-3-Clause
"""What a run of a fleet's maps did, and what it took."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from ndtree.distributed.scans import ScanIndex
from ndtree.distributed.stages import BlockRecord, Prepared


@dataclass(frozen=True)
class FleetReport:
    """What a run did.

    Attributes
    ----------
    scans, beams : int
        Taken in; each once, however many blocks it crosses.
    refused, ignored : int
        Scans that no map of the kind takes, and beams left out because they did not return.
    tiles, blocks : int
        That were mapped.
    block_beams : int
        Beams over all blocks: those of a scan that crosses several count in each.
    scan_bytes : int
        Of the stored scans.
    bytes_read, written_bytes : int
        Beams that tasks have looked at, and all that was written: scans, states and tiles.
    seconds : float
        From beginning to end [s].
    start_seconds : float
        Of these, until the engine was there [s].
    prepare_seconds, task_seconds, insert_seconds : float
        Sums over all tasks: of reading logs, of blocks, and of these, insertion itself [s].
    state_seconds, store_seconds : float
        Of the time of blocks, what their states took, and the tiles in the end [s].
    engine_seconds : float
        Sum over all tasks, from when the engine got them to when it gave their results, without what they
        took themselves: its scheduling, its messages, and the start of its workers [s].
    cpu_seconds : float
        Processor time of all tasks, and of the thread that called [s]; without the engine's own processes.
    peak_memory : int
        Of the worker that took most, as the system counts it, mapped files included [bytes].
    longest_block_seconds : float
        Of the block that took longest [s]: no number of workers is faster.
    records : list of BlockRecord
        Of each block.
    """

    scans: int
    beams: int
    refused: int
    ignored: int
    tiles: int
    blocks: int
    block_beams: int
    scan_bytes: int
    bytes_read: int
    written_bytes: int
    seconds: float
    start_seconds: float
    prepare_seconds: float
    task_seconds: float
    insert_seconds: float
    state_seconds: float
    store_seconds: float
    engine_seconds: float
    cpu_seconds: float
    peak_memory: int
    longest_block_seconds: float
    workers: int
    records: list[BlockRecord]

    @property
    def idle(self) -> float:
        """Share of the workers' time, once there were any, in which they did nothing, planning included."""
        there = (self.seconds - self.start_seconds) * self.workers
        return max(0.0, 1.0 - (self.prepare_seconds + self.task_seconds) / there)

    def figures(self) -> dict[str, Any]:
        """All but the records, ready for JSON."""
        return {
            **{k: v for k, v in asdict(replace(self, records=[])).items() if k != "records"},
            "idle": self.idle,
        }


class Times:
    """How long a call takes."""

    def __init__(self) -> None:
        self._begin, self._cpu_begin = time.perf_counter(), time.thread_time()
        self.start = 0.0  # Until the engine was there.

    def of(
        self, report: FleetReport, prepared: Sequence[Prepared] = (), at_engine: float = 0.0
    ) -> FleetReport:
        """A report of the blocks, with what the call took, and reading the logs if it did that."""
        seconds = sum(one.seconds for one in prepared)
        cpu_seconds = time.thread_time() - self._cpu_begin + sum(one.cpu_seconds for one in prepared)
        return replace(
            report,
            seconds=time.perf_counter() - self._begin,
            start_seconds=self.start,
            prepare_seconds=seconds,
            engine_seconds=report.engine_seconds + max(0.0, at_engine - seconds),
            cpu_seconds=report.cpu_seconds + cpu_seconds,
            peak_memory=max([report.peak_memory, *(one.peak_memory for one in prepared)]),
            written_bytes=report.written_bytes + (report.scan_bytes if prepared else 0),
        )


#: Of a report, what is a sum over blocks, and what of their records.
_SUMS = {
    "block_beams": "beams", "bytes_read": "bytes_read", "written_bytes": "written_bytes",
    "task_seconds": "seconds", "insert_seconds": "insert_seconds", "state_seconds": "state_seconds",
    "store_seconds": "store_seconds", "cpu_seconds": "cpu_seconds",
}  # fmt: skip


def report_of(
    records: list[BlockRecord], scans: list[Any], indexes: list[ScanIndex], at_engine: float, workers: int
) -> FleetReport:
    """Of blocks, scans and logs; what the call itself takes is 0 until `Times` says it."""
    sums = {name: sum(getattr(record, of) for record in records) for name, of in _SUMS.items()}
    return FleetReport(
        scans=len(scans),
        beams=sum(scan.where.beams for _, scan in scans),
        refused=sum(index.refused for index in indexes),
        ignored=sum(index.ignored for index in indexes),
        tiles=sum(len(record.entries) for record in records),
        blocks=len(records),
        scan_bytes=sum(index.stored_bytes for index in indexes),
        engine_seconds=max(0.0, at_engine - sums["task_seconds"]),
        peak_memory=max((record.peak_memory for record in records), default=0),
        longest_block_seconds=max((record.seconds for record in records), default=0.0),
        workers=workers,
        records=records,
        **dict.fromkeys(("seconds", "start_seconds", "prepare_seconds"), 0.0),
        **sums,
    )
