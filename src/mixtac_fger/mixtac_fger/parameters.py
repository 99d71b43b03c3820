# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the force estimator node."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from mixtac_core.node.parameters import ParameterError, fixed, parameter
from mixtac_fger.contact_tracking import ContactSettings
from mixtac_fger.displacement import skin_scale
from mixtac_fger.weights import DEFAULT_MODEL

POLICIES: Final = ('withhold', 'publish')
"""What becomes of a force that cannot be trusted; the first is the default."""
DISPLACEMENT: Final = ('off', 'frames', 'windows')
"""When the displacement of the beads is published; the first is the default."""


@dataclass(frozen=True)
class FgerParameters:
    """Parameters of the node; changes take effect at once unless a description excludes it.

    Attributes:
        autostart: Configure and activate the node once at its start; it ends if it cannot be. The
            launch files set this.
        model: Network weights: the path of a .safetensors file, or the name of a model that comes
            with mixtac_fger. Any architecture with an installed estimator. Fixed while the node is
            configured: clean it up to change the model.
        frame_id: Frame of the published force: x to the right and y upwards in the image, z from
            the contact into the gel.
        force_scale: Factor of the published force: true force over estimated force, from the
            calibration of this sensor. Gels differ in stiffness, which no image shows.
        sideways_scale: Factor of the published sideways force and torsion beside force_scale, from
            a weight that hangs from the tip.
        reference: Name of the file of the no-contact reference of this sensor, such as
            left_finger.npz, in the state folder ($MIXTAC_HOME, by default ~/.local/state/mixtac).
            If empty, the file is that of the camera's serial number, reference_SERIAL.npz. ~/tare
            writes it. If it exists, the sensor may be in contact at the start. Otherwise the zero
            is unknown until ~/tare, unless assume_free is set.
        assume_free: Nothing touches the sensor when the node is activated: the first still frames
            are the reference where no reference is named. Set by `mixtac up` and the launch files
            for the virtual sensor and recordings.
        contact_threshold: Forces above this count as contact; ~/tare is refused during contact.
        contact: Find where the sensor is touched, and publish `contact` and `contact_point`, while
            somebody subscribes. Takes effect at the next
            activation, as do `contact_on` to `displacement`.
        contact_on: Force from which on `contact` says that something touches the sensor.
        contact_off: Force below which `contact` says that the touch has ended.
        object_radius: Radius of curvature of what touches the sensor. Where it is known, the area
            of the contact is more accurate; 0 if it is not.
        px_per_mm: Scale of the picture at the skin on the optical axis, where it was measured. 0 is
            the scale of the camera's calibration (6 %), or the usual one (8 %).
        displacement: Publish the displacement of the beads since the reference: `frames` at the
            rate of the frames, `windows` also at 500 Hz, carried by events.
        tare_on_release: Tare after each contact, once the sensor has been free and still for 2 s.
            It removes slow drift of lamp, temperature and gel, and also a contact below about 0.1 N
            that stays after a release.
        invalid_force: What becomes of a force that cannot be trusted: `withhold` publishes none,
            `publish` publishes it as it is. In each case `force_quality` says that the force is not
            valid, and why.
        stale_frame_age: Age of the latest frame above which the force is not valid. Without frames
            the force drifts.
        image_transport: Frames are received as `raw` from image_raw, or `compressed` from
            image_raw/compressed, as `image_transport republish` sends them. Takes effect at the
            next activation.
        longest_without_frame: Age of the latest frame above which no force is published until the
            next frame.
        deadline: Longest time from the arrival of the packet that completes a window (its first
            events, at the host) to the publication of its force; later forces count as late on
            /diagnostics. A packet spans 1 ms.
    """

    autostart: bool = fixed(False)
    model: str = parameter(DEFAULT_MODEL)
    frame_id: str = parameter('mixtac_contact')
    force_scale: float = parameter(1.0, within=(0.1, 10.0))
    sideways_scale: float = parameter(1.0, within=(0.1, 10.0))
    reference: str = parameter('')
    assume_free: bool = parameter(False)
    contact_threshold: float = parameter(0.15, unit='N', within=(0.01, 10.0))
    contact: bool = parameter(True)
    contact_on: float = parameter(0.03, unit='N', within=(0.005, 10.0))
    contact_off: float = parameter(0.02, unit='N', within=(0.0, 10.0))
    object_radius: float = parameter(0.0, unit='mm', within=(0.0, 1000.0))
    px_per_mm: float = parameter(0.0, unit='px/mm', within=(0.0, 1000.0))
    displacement: str = parameter('off', choices=DISPLACEMENT)
    tare_on_release: bool = parameter(False)
    invalid_force: str = parameter('withhold', choices=POLICIES)
    stale_frame_age: float = parameter(0.2, unit='s', within=(0.05, 60.0))
    image_transport: str = parameter('raw', choices=('raw', 'compressed'))
    longest_without_frame: float = parameter(2.0, unit='s', within=(0.05, 3600.0))
    deadline: float = parameter(0.003, unit='s', within=(0.0005, 1.0))

    def __post_init__(self) -> None:
        """Check values against each other.

        Raises:
            ParameterError: A contact would end above the force at which it begins.
        """
        if self.contact_off > self.contact_on:
            raise ParameterError(
                f'parameter contact_off = {self.contact_off:g} N: give at most contact_on ='
                f' {self.contact_on:g} N'
            )

    def contact_settings(self, focal_px: float, axis_px: tuple[float, float]) -> ContactSettings:
        """Return how contacts are found by a camera; see `mixtac_fger.displacement.skin_scale`."""
        scale = skin_scale(self.px_per_mm, focal_px, axis_px)
        return ContactSettings(self.contact_on, self.contact_off, self.object_radius, scale)

    def estimator_options(self) -> dict[str, Any]:
        """Return the settings of a `ForceEstimator` that may change while it runs, by name."""
        return {
            'force_scale': self.force_scale,
            'sideways_scale': self.sideways_scale,
            'contact_threshold_n': self.contact_threshold,
            'longest_without_frame_us': round(self.longest_without_frame * 1e6),
            'stale_frame_us': round(self.stale_frame_age * 1e6),
            'tare_on_release': self.tare_on_release,
        }
