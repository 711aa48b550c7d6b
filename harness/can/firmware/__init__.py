"""The instrument's electronics as a C program that speaks slcan on a pseudo-terminal.

| file | holds | for a firmware |
| --- | --- | --- |
| `board.c`, `board.h` | protocol, protection, drive, schedule | yes |
| `slcan.c`, `slcan.h` | the ASCII protocol of CAN adapters on a serial line | where it has one |
| `bus.c`, `bus.h`, `attributes.h` | packing code and limits, generated from the DBC | yes |
| `faults.c`, `faults.h` | faults on demand, from a seed | no |
| `host.c` | terminal, clock, recording, log, options | no |

Frames, protection and schedule are those of a real board. What is not: there is no arbitration and
no bit time, all frames of a millisecond leave at once, and a host that does not read loses frames.
"""

from harness.can.firmware.build import build_board, sources
from harness.can.firmware.process import FirmwareBoard, fault_kinds, write_samples

__all__ = ["FirmwareBoard", "build_board", "fault_kinds", "sources", "write_samples"]
