"""What the native control step measures: the contacts between device and wall, and the step's summary."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np

from cathsim.contact.native import StepSummary, address

MAX_CONTACTS = 512


@dataclass(frozen=True)
class Contacts:
    """Contacts with the wall in the substep in which their resultant was largest."""

    points: np.ndarray  # world positions, m. Shape (k, 3).
    forces: np.ndarray  # force of the wall on the device, N, world frame. Shape (k, 3).


class MeasuredContacts:
    """The buffers that a control step of some substeps writes to, and what they hold.

    Attributes:
        summary: of the last control step.
        depths: deepest penetration after each substep, m, where the simulation measures it. Shape (substeps,).
    """

    def __init__(self, substeps: int) -> None:
        self._points, self._forces = np.zeros((MAX_CONTACTS, 3)), np.zeros((MAX_CONTACTS, 3))
        self._scratch = np.zeros((4 * MAX_CONTACTS, 3))
        self.depths, self.summary = np.zeros(substeps), StepSummary()

    def arguments(self) -> tuple[Any, ...]:
        """The last arguments of `cathsim_step`."""
        arrays = self._points, self._forces, self._scratch, self.depths
        return MAX_CONTACTS, *(address(array) for array in arrays), ctypes.byref(self.summary)

    def clear(self) -> None:
        """Forgets the summary, and with it the contacts."""
        ctypes.memset(ctypes.byref(self.summary), 0, ctypes.sizeof(self.summary))

    def contacts(self) -> Contacts:
        """The contacts of the last control step, where their resultant was largest."""
        count = self.summary.contacts
        return Contacts(self._points[:count].copy(), self._forces[:count].copy())

    def padded(self) -> Contacts:
        """`contacts`, followed by rows of zeros: always of shape (MAX_CONTACTS, 3)."""
        count = self.summary.contacts
        padded = Contacts(np.zeros((MAX_CONTACTS, 3)), np.zeros((MAX_CONTACTS, 3)))
        padded.points[:count], padded.forces[:count] = self._points[:count], self._forces[:count]
        return padded

    def state(self) -> tuple[bytes, np.ndarray, np.ndarray]:
        """The measurement, for `restore`; without the depths."""
        contacts = self.contacts()
        return bytes(self.summary), contacts.points, contacts.forces

    def restore(self, state: tuple[bytes, np.ndarray, np.ndarray]) -> None:
        """Returns to a measurement of `state`."""
        summary, points, forces = state
        ctypes.memmove(ctypes.byref(self.summary), summary, ctypes.sizeof(self.summary))
        self._points[: len(points)], self._forces[: len(forces)] = points, forces
