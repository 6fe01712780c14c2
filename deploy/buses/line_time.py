"""How long a period's packets are on the line: what no host can be faster than."""

from __future__ import annotations

from typing import Final

from controller.rig import Rig
from controller.schedule import TransactionKind, period, schedule_of
from deploy.buses.port import BITS_PER_BYTE

# bytes around the parameters of each packet: header, id, length, instruction or error, checksum
_BYTES: Final = {"dynamixel-2.0": (10, 11, 4), "dynamixel-1.0": (6, 6, 2), "feetech": (6, 6, 2)}


def period_line_s(rig: Rig) -> float:
    """Return how long the packets of the longest period take on the line, return delays included [s].

    Args:
        rig: the rig
    """
    family = rig.joints[0].family
    question, status, header = _BYTES[family.protocol]
    schedule = schedule_of(rig)
    nservo, delay_s = len(rig.joints), 1e-6 * rig.bus.return_delay_us
    longest = 0.0
    for k in range(nservo * len(schedule.health) * schedule.health_every):
        nbyte = nreply = 0
        for due in period(schedule, k):
            if due.kind is TransactionKind.READ_STATE:
                asked = question + header + nservo if family.sync_read else nservo * (question + header)
                nbyte += asked + nservo * (status + due.size)
                nreply += nservo
            elif due.kind is TransactionKind.WRITE_GOALS:
                nbyte += question + header + nservo * (1 + due.size)
            elif due.kind is TransactionKind.READ_HEALTH:
                nbyte += question + header + status + due.size
                nreply += 1
        longest = max(longest, nbyte * BITS_PER_BYTE / rig.bus.baud + nreply * delay_s)
    return longest
