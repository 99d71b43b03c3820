# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Identity of the camera, read when it is opened: versions, chip, clocks, geometry, features.

Cameras with unsupported firmware, logic or chip are refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mixtac_driver.davis346.model import (
    CHIP_NAMES,
    LOGIC_VERSION,
    MINIMUM_FIRMWARE,
    MINIMUM_LOGIC_PATCH,
    SUPPORTED_CHIPS,
    Geometry,
)
from mixtac_driver.davis346.registers import Aps, Dvs, ExternalInput, Imu, Module, Mux, SystemInfo
from mixtac_driver.errors import UnsupportedCameraError

if TYPE_CHECKING:
    from mixtac_driver.usb.protocol import Protocol


@dataclass(frozen=True, slots=True)
class Clocks:
    """Clock frequencies of the logic [MHz], deviation included."""

    logic: float
    adc: float
    usb: float


@dataclass(frozen=True, slots=True)
class Features:
    """Blocks that a build of the logic may lack, and the colour filter of the pixels.

    Attributes:
        color_filter: 0 monochrome, 1 .. 8 a colour filter.
    """

    pixel_filter: bool = True
    background_activity: bool = True
    roi: bool = True
    skip: bool = True
    polarity: bool = True
    dvs_statistics: bool = True
    color_filter: int = 0
    global_shutter: bool = True
    generator: bool = True
    mux_statistics: bool = True


@dataclass(frozen=True, slots=True)
class Identity:
    """What a camera says of itself.

    Attributes:
        serial: Serial number.
        firmware: USB controller firmware, (major, minor).
        logic: FPGA logic, (version, patch).
        chip: Name of the sensor chip.
        is_master: False where another camera's clock drives this one.
        clocks: Clocks for converting times to cycles.
        geometry: Pixel arrays.
        imu_type: 0 none, 1 MPU6050, 2 MPU9250.
        imu_flips: True per axis (x, y, z) where the unit is mounted the other way round.
        features: Blocks the logic has.
    """

    serial: str
    firmware: tuple[int, int]
    logic: tuple[int, int]
    chip: str
    is_master: bool
    clocks: Clocks
    geometry: Geometry
    imu_type: int
    imu_flips: tuple[bool, bool, bool]
    features: Features


def check_firmware(bcd_device: int) -> tuple[int, int]:
    """Return the firmware version of a USB device release number.

    Raises:
        UnsupportedCameraError: Older than 0.6, or the 1.0 series with its other protocol.
    """
    major, minor = bcd_device >> 8, bcd_device & 0xFF
    if major != 0:
        raise UnsupportedCameraError(
            f'camera firmware {major}.{minor} speaks another USB protocol than the 0.6 series; '
            'use a camera with firmware 0.6 or newer below 1.0'
        )
    if minor < MINIMUM_FIRMWARE:
        raise UnsupportedCameraError(
            f'camera firmware 0.{minor} is older than 0.{MINIMUM_FIRMWARE}; update it'
        )
    return major, minor


def read_identity(protocol: Protocol, *, bcd_device: int, serial: str) -> Identity:
    """Read what the camera is, in the order in which libcaer asks.

    Args:
        protocol: Register access.
        bcd_device: Release number from the device descriptor.
        serial: Serial number from the string descriptor.

    Raises:
        UnsupportedCameraError: Firmware, logic or chip is none of those this driver speaks to.
        UsbError: A request failed.
    """
    firmware = check_firmware(bcd_device)

    def info(parameter: SystemInfo) -> int:
        return protocol.read(Module.SYSTEM_INFO, parameter)

    logic = _check_logic(info(SystemInfo.LOGIC_VERSION), info(SystemInfo.LOGIC_PATCH))
    chip = _check_chip(info(SystemInfo.CHIP_IDENTIFIER))
    is_master = bool(info(SystemInfo.DEVICE_IS_MASTER))
    features = _read_features(protocol)
    geometry = _read_geometry(protocol)
    imu_type = protocol.read(Module.IMU, Imu.TYPE)
    clocks = _read_clocks(protocol)
    imu_orientation = protocol.read(Module.IMU, Imu.ORIENTATION)
    return Identity(
        serial=serial,
        firmware=firmware,
        logic=logic,
        chip=chip,
        is_master=is_master,
        clocks=clocks,
        geometry=geometry,
        imu_type=imu_type,
        imu_flips=(bool(imu_orientation & 4), bool(imu_orientation & 2), bool(imu_orientation & 1)),
        features=features,
    )


def read_is_master(protocol: Protocol) -> bool:
    """Return whether the camera runs on its own clock; changes with the synchronisation cable."""
    return bool(protocol.read(Module.SYSTEM_INFO, SystemInfo.DEVICE_IS_MASTER))


def _check_logic(version: int, patch: int) -> tuple[int, int]:
    if version != LOGIC_VERSION or patch < MINIMUM_LOGIC_PATCH:
        wanted = f'{LOGIC_VERSION}.{MINIMUM_LOGIC_PATCH}'
        raise UnsupportedCameraError(
            f'camera logic {version}.{patch} is not {wanted}; update the camera to logic {wanted}'
        )
    return version, patch


def _check_chip(identifier: int) -> str:
    name = CHIP_NAMES.get(identifier, 'unknown')
    if identifier not in SUPPORTED_CHIPS:
        raise UnsupportedCameraError(
            f'chip {identifier} ({name}) is no DAVIS346; attach a DAVIS346 or pick one by serial'
        )
    return name


def _read_features(protocol: Protocol) -> Features:
    def has(module: Module, parameter: int) -> bool:
        return bool(protocol.read(module, parameter))

    # Arguments are evaluated as they stand, which is the order of the reads.
    return Features(
        pixel_filter=has(Module.DVS, Dvs.HAS_PIXEL_FILTER),
        background_activity=has(Module.DVS, Dvs.HAS_BACKGROUND_ACTIVITY_FILTER),
        roi=has(Module.DVS, Dvs.HAS_ROI),
        skip=has(Module.DVS, Dvs.HAS_SKIP),
        polarity=has(Module.DVS, Dvs.HAS_POLARITY),
        dvs_statistics=has(Module.DVS, Dvs.HAS_STATISTICS),
        color_filter=protocol.read(Module.APS, Aps.COLOR_FILTER),
        global_shutter=has(Module.APS, Aps.HAS_GLOBAL_SHUTTER),
        generator=has(Module.EXTERNAL_INPUT, ExternalInput.HAS_GENERATOR),
        mux_statistics=has(Module.MUX, Mux.HAS_STATISTICS),
    )


def _read_geometry(protocol: Protocol) -> Geometry:
    dvs = [protocol.read(Module.DVS, p) for p in (Dvs.SIZE_COLUMNS, Dvs.SIZE_ROWS, Dvs.ORIENTATION)]
    aps = [protocol.read(Module.APS, p) for p in (Aps.SIZE_COLUMNS, Aps.SIZE_ROWS, Aps.ORIENTATION)]
    for columns, rows, _ in (dvs, aps):
        if sorted((columns, rows)) != [260, 346]:
            raise UnsupportedCameraError(
                f'pixel array of {columns} x {rows}; a DAVIS346 has 346 x 260 pixels'
            )
    return Geometry(
        dvs_columns=dvs[0],
        dvs_rows=dvs[1],
        dvs_inverted=bool(dvs[2] & 4),
        aps_columns=aps[0],
        aps_rows=aps[1],
        aps_inverted=bool(aps[2] & 4),
        aps_flip_x=bool(aps[2] & 2),
        aps_flip_y=bool(aps[2] & 1),
    )


def _read_clocks(protocol: Protocol) -> Clocks:
    nominal = [
        protocol.read(Module.SYSTEM_INFO, p)
        for p in (SystemInfo.LOGIC_CLOCK, SystemInfo.ADC_CLOCK, SystemInfo.USB_CLOCK)
    ]
    deviation = protocol.read(Module.SYSTEM_INFO, SystemInfo.CLOCK_DEVIATION)
    if not (500 <= deviation <= 2000 and all(1 <= mhz <= 1000 for mhz in nominal)):
        raise UnsupportedCameraError(
            f'camera clocks {nominal} MHz x {deviation}/1000 cannot be; plug the camera anew'
        )
    return Clocks(*(mhz * deviation / 1000 for mhz in nominal))
