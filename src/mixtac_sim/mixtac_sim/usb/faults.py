# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What can be made to go wrong on a virtual camera; standard library only.

A `Fault` is handed to `mixtac_sim.usb.device.VirtualDavis346.inject`, or from another process to
`mixtac_sim.usb.fault_client.inject`. No real camera knows anything of this.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from enum import Enum

from mixtac_sim.usb.errors import FaultError


class FaultKind(str, Enum):
    """Kinds of faults.

    Attributes:
        UNPLUG: The camera disappears; after ``seconds`` it is plugged in again, as after
            power-up, with ``serial`` as its serial number if that is given.
        PLUG_IN: The camera comes back now.
        STALL_DATA: The data endpoint halts until the host clears the halt, ``count`` times.
        STALL_CONTROL: Vendor requests are refused.
        TIMEOUT_CONTROL: Control requests find no answer, except those that a kernel answers.
        DELAY_CONTROL: Control requests are answered ``delay`` seconds late.
        GARBAGE_REGISTERS: Registers read as random numbers.
        SHORT_READS: Reads return a random number of bytes, odd ones too; the other half of a word
            that was cut is lost.
        DROP_BYTES: ``size`` bytes are lost, rounded up to whole words.
        GARBAGE_WORDS: ``size`` bytes of random words come between the data.
        FREEZE: The data endpoint has nothing to send; with neither ``seconds`` nor ``count`` until
            the host starts the stream anew.
        HANG_READS: Reads do not return, not even at their time-out, until the port is reset.
        BABBLE: Reads fail because more came than was asked for (EOVERFLOW).
        READ_ERROR: Reads fail on the bus (EIO).
        CLOCK_RESET: The camera's clock restarts, as by the synchronisation cable.
        CLEAR: All faults end.
    """

    UNPLUG = 'unplug'
    PLUG_IN = 'plug_in'
    STALL_DATA = 'stall_data'
    STALL_CONTROL = 'stall_control'
    TIMEOUT_CONTROL = 'timeout_control'
    DELAY_CONTROL = 'delay_control'
    GARBAGE_REGISTERS = 'garbage_registers'
    SHORT_READS = 'short_reads'
    DROP_BYTES = 'drop_bytes'
    GARBAGE_WORDS = 'garbage_words'
    FREEZE = 'freeze'
    HANG_READS = 'hang_reads'
    BABBLE = 'babble'
    READ_ERROR = 'read_error'
    CLOCK_RESET = 'clock_reset'
    CLEAR = 'clear'


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault.

    Attributes:
        kind: What goes wrong.
        seconds: How long [s]; 0 without end.
        count: After how many requests or reads it ends; 0 without end.
        delay: How late answers come [s].
        size: How many bytes are concerned.
        seed: Of what is random.
        serial: Serial number after `FaultKind.UNPLUG` or `FaultKind.PLUG_IN`; empty for the same.
    """

    kind: FaultKind
    seconds: float = 0.0
    count: int = 0
    delay: float = 0.0
    size: int = 0
    seed: int = 0
    serial: str = ''

    def to_json(self) -> bytes:
        """Return the fault as a JSON object with the names of the attributes."""
        return json.dumps(asdict(self)).encode()

    @classmethod
    def from_json(cls, data: bytes) -> Fault:
        """Return the fault that `to_json` wrote; what is missing has its default.

        Raises:
            FaultError: It is none.
        """
        try:
            fields = json.loads(data)
            return cls(**{**fields, 'kind': FaultKind(fields['kind'])})
        except (ValueError, KeyError, TypeError) as error:
            known = ', '.join(kind.value for kind in FaultKind)
            raise FaultError(f'{data!r} is no fault ({error}); kinds are {known}') from error
