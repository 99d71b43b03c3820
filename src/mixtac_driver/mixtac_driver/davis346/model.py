# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Camera models, and the identity of an opened camera: versions, chip, clocks, geometry.

`CameraModel` describes one camera of the DAVIS family; the sizes and the orientation of the arrays
are read from the camera itself. Other packages add models by the entry-point group
`mixtac.camera_models`. Cameras that fit no model are refused. A logic that lacks a block ignores
writes to its registers, and reads them as zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from types import MappingProxyType

from mixtac_driver.davis346.biases import DEFAULT_BIASES, Bias
from mixtac_driver.davis346.registers import (
    Aps,
    Chip,
    Dvs,
    ExternalInput,
    Imu,
    Module,
    SystemInfo,
)
from mixtac_driver.errors import UnsupportedCameraError
from mixtac_driver.usb.protocol import Protocol

GROUP = 'mixtac.camera_models'
"""Entry points of this group name a `CameraModel`."""
CHIP_NAMES = {4: 'DAVIS346A', 5: 'DAVIS346B', 9: 'DAVIS346C'}


@dataclass(frozen=True)
class CameraModel:
    """A camera of the DAVIS family, as far as it is the same for all cameras of that model.

    Attributes:
        name: Device string that opens such a camera on USB.
        vendor: USB vendor number.
        product: USB product number.
        chips: Identifiers of the chips of this model (see CHIP_NAMES).
        width: Columns of the pixel arrays.
        height: Rows of the pixel arrays.
        has_frames: False for a camera with event pixels only.
        minimum_firmware: Oldest minor version of USB firmware 0.x; 1.0 and newer speak another
            protocol.
        logic_version: Version of the FPGA logic, which defines the register layout
            (`mixtac_driver.davis346.registers`).
        minimum_logic_patch: Oldest patch of that version.
        biases: Biases by name, in the order of writing. Those of `BiasParameters` can be set, the
            others keep their default.
        chip_registers: Chip registers and their defaults, in the order of writing.
    """

    name: str
    vendor: int
    product: int
    chips: tuple[int, ...]
    width: int
    height: int
    has_frames: bool
    minimum_firmware: int
    logic_version: int
    minimum_logic_patch: int
    biases: Mapping[str, Bias]
    chip_registers: Mapping[int, int]


DAVIS346 = CameraModel(
    name='davis346',
    vendor=0x152A,
    product=0x841A,
    chips=(4, 5, 9),
    width=346,
    height=260,
    has_frames=True,
    minimum_firmware=6,
    logic_version=18,
    minimum_logic_patch=1,
    biases=DEFAULT_BIASES,
    chip_registers=MappingProxyType(
        {
            **dict.fromkeys(range(128, 136), 0),
            Chip.RESET_CALIBRATION_NEURON: 1,
            Chip.TYPE_N_CALIBRATION_NEURON: 0,
            Chip.RESET_TEST_PIXEL: 1,
            Chip.AER_NA_ROW: 0,
            Chip.USE_A_OUT: 0,
            Chip.SELECT_GRAY_COUNTER: 1,
            Chip.TEST_ADC: 0,
        }
    ),
)


OPTIONAL_BLOCKS = {
    (Module.DVS, Dvs.HAS_BACKGROUND_ACTIVITY_FILTER): 4,
    (Module.DVS, Dvs.HAS_SKIP): 2,
    (Module.EXTERNAL_INPUT, ExternalInput.HAS_GENERATOR): 6,
}
"""Registers of the blocks that some logic lacks; they follow the one that reports the block."""


@cache
def camera_models() -> tuple[CameraModel, ...]:
    """Return the DAVIS346 and the models that installed packages add."""
    return DAVIS346, *(point.load() for point in entry_points(group=GROUP))


def models_for(device: str) -> tuple[CameraModel, ...]:
    """Return the models that a device string may open: the one it names, otherwise all."""
    if device == DAVIS346.name:
        return (DAVIS346,)
    models = camera_models()
    return tuple(model for model in models if model.name == device) or models


@dataclass(frozen=True, slots=True)
class Geometry:
    """Sizes and orientations of the two pixel arrays, as the stream decoder needs them.

    Attributes:
        dvs_columns: Limit of column addresses on the wire.
        dvs_rows: Limit of row addresses on the wire.
        dvs_inverted: True where row addresses are x and column addresses y.
        aps_columns: Columns read out per frame.
        aps_rows: Samples per column.
        aps_inverted: True where columns are read out along y.
        aps_flip_x: True where the first column is the last one of the image.
        aps_flip_y: True where the first sample is the last one of a column.
    """

    dvs_columns: int = 260
    dvs_rows: int = 346
    dvs_inverted: bool = True
    aps_columns: int = 260
    aps_rows: int = 346
    aps_inverted: bool = True
    aps_flip_x: bool = False
    aps_flip_y: bool = False

    @property
    def width(self) -> int:
        """Width of the image [pixels]."""
        return self.aps_rows if self.aps_inverted else self.aps_columns

    @property
    def height(self) -> int:
        """Height of the image [pixels]."""
        return self.aps_columns if self.aps_inverted else self.aps_rows

    @property
    def event_size(self) -> tuple[int, int]:
        """Width and height of the event array [pixels]."""
        size = (self.dvs_columns, self.dvs_rows)
        return (size[1], size[0]) if self.dvs_inverted else size


@dataclass(frozen=True, slots=True)
class Clocks:
    """Clock frequencies of the logic [MHz], deviation included."""

    logic: float
    adc: float
    usb: float


@dataclass(frozen=True, slots=True)
class Identity:
    """What an opened camera reports about itself.

    Attributes:
        model: Its model.
        serial: Serial number.
        chip: Name of the sensor chip.
        geometry: Pixel arrays.
        clocks: Clocks for converting times to cycles.
        firmware: USB controller firmware, (major, minor).
        logic: FPGA logic, (version, patch).
        is_master: False where another camera's clock drives this one.
        imu_type: 0 none, 1 MPU6050, 2 MPU9250.
        imu_flips: True per axis (x, y, z) whose direction on the unit is reversed.
        color_filter: 0 monochrome, 1 .. 8 a colour filter.
        absent: Registers that the logic lacks, which are not written: (module, number).
    """

    model: CameraModel
    serial: str
    chip: str
    geometry: Geometry
    clocks: Clocks
    firmware: tuple[int, int] = (0, 0)
    logic: tuple[int, int] = (0, 0)
    is_master: bool = True
    imu_type: int = 0
    imu_flips: tuple[bool, bool, bool] = (False, False, False)
    color_filter: int = 0
    absent: frozenset[tuple[int, int]] = frozenset()


def check_firmware(bcd_device: int, minimum: int = DAVIS346.minimum_firmware) -> tuple[int, int]:
    """Return the firmware version of a USB device release number.

    Args:
        bcd_device: Release number from the device descriptor.
        minimum: Oldest supported minor version.

    Raises:
        UnsupportedCameraError: Older than that, or the 1.0 series with its other protocol.
    """
    major, minor = bcd_device >> 8, bcd_device & 0xFF
    if major != 0:
        raise UnsupportedCameraError(
            f'camera firmware {major}.{minor} has another USB protocol than the 0.{minimum} series',
            remedy=f'use a camera with firmware 0.{minimum} or newer below 1.0',
        )
    if minor < minimum:
        raise UnsupportedCameraError(
            f'camera firmware 0.{minor} is older than 0.{minimum}',
            remedy='update the firmware of the camera',
        )
    return major, minor


def read_identity(
    protocol: Protocol, models: Sequence[CameraModel], *, bcd_device: int, serial: str
) -> Identity:
    """Read the identity of a camera, in the order of libcaer, and match it with a model.

    Args:
        protocol: Register access.
        models: Models to choose from.
        bcd_device: Release number from the device descriptor.
        serial: Serial number from the string descriptor.

    Raises:
        UnsupportedCameraError: Firmware, logic, chip or array size fits none of the models.
        UsbError: A request failed.
    """
    firmware = check_firmware(bcd_device, min(model.minimum_firmware for model in models))
    logic = (
        protocol.read(Module.SYSTEM_INFO, SystemInfo.LOGIC_VERSION),
        protocol.read(Module.SYSTEM_INFO, SystemInfo.LOGIC_PATCH),
    )
    chip = protocol.read(Module.SYSTEM_INFO, SystemInfo.CHIP_IDENTIFIER)
    model = _choose_model(models, chip)
    check_firmware(bcd_device, model.minimum_firmware)
    if logic[0] != model.logic_version or logic[1] < model.minimum_logic_patch:
        wanted = f'{model.logic_version}.{model.minimum_logic_patch}'
        raise UnsupportedCameraError(
            f'camera logic {logic[0]}.{logic[1]} is not {wanted}',
            remedy=f'update the camera to logic {wanted}',
        )
    is_master = read_is_master(protocol)
    color_filter = protocol.read(Module.APS, Aps.COLOR_FILTER)
    geometry = _read_geometry(protocol, model)
    imu_type = protocol.read(Module.IMU, Imu.TYPE)
    clocks = _read_clocks(protocol)
    imu_orientation = protocol.read(Module.IMU, Imu.ORIENTATION)
    absent = frozenset(
        (module, number + k)
        for (module, number), count in OPTIONAL_BLOCKS.items()
        if not protocol.read(module, number)
        for k in range(1, count + 1)
    )
    return Identity(
        model=model,
        serial=serial,
        firmware=firmware,
        logic=logic,
        chip=CHIP_NAMES.get(chip, model.name),
        is_master=is_master,
        clocks=clocks,
        geometry=geometry,
        imu_type=imu_type,
        imu_flips=(bool(imu_orientation & 4), bool(imu_orientation & 2), bool(imu_orientation & 1)),
        color_filter=color_filter,
        absent=absent,
    )


def read_is_master(protocol: Protocol) -> bool:
    """Return whether the camera runs on its own clock; changes with the synchronisation cable."""
    return bool(protocol.read(Module.SYSTEM_INFO, SystemInfo.DEVICE_IS_MASTER))


def _choose_model(models: Sequence[CameraModel], chip: int) -> CameraModel:
    for model in models:
        if chip in model.chips:
            return model
    known = ', '.join(CHIP_NAMES.get(each, str(each)) for m in models for each in m.chips)
    raise UnsupportedCameraError(
        f'chip {chip} is not supported here',
        remedy=f'attach a camera with one of the chips {known}, or choose one by its serial number',
    )


def _read_geometry(protocol: Protocol, model: CameraModel) -> Geometry:
    def array(module: Module, columns: int, rows: int, orientation: int) -> tuple[int, int, int]:
        size = protocol.read(module, columns), protocol.read(module, rows)
        if sorted(size) != sorted((model.width, model.height)):
            found, wanted = f'{size[0]} x {size[1]}', f'{model.width} x {model.height}'
            raise UnsupportedCameraError(f'pixel array of {found}: a {model.name} has {wanted}')
        return *size, protocol.read(module, orientation)

    dvs = array(Module.DVS, Dvs.SIZE_COLUMNS, Dvs.SIZE_ROWS, Dvs.ORIENTATION)
    aps = dvs
    if model.has_frames:
        aps = array(Module.APS, Aps.SIZE_COLUMNS, Aps.SIZE_ROWS, Aps.ORIENTATION)
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
    if not (deviation and all(nominal)):
        raise UnsupportedCameraError('a camera clock is 0 MHz', remedy='reconnect the camera')
    return Clocks(*(mhz * deviation / 1000 for mhz in nominal))
