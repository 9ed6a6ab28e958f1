"""Pictures of an environment for people: as arrays, or in a window."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from cathsim.presets import CONTROL_STEP

if TYPE_CHECKING:
    from cathsim.observations.fluoroscopes import Fluoroscope
    from cathsim.robot.follower import FollowerRobot
    from cathsim.viewing.camera_view import View

MODES = ("human", "rgb_array", "fluoroscopy")
_SDL_DRIVER = "SDL_VIDEODRIVER"  # which screen SDL, that pygame draws with, has to take
LEAST_HEIGHT = 480  # px of the window: smaller pictures are enlarged by a whole number


def modes_here() -> list[str]:
    """The render modes that can be used on this machine: those for people only where there is a screen."""
    return [mode for mode in MODES if mode != "human" or _screen_named()]


def _screen_named() -> bool:
    return sys.platform != "linux" or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY", _SDL_DRIVER)))


class Display:
    """Draws the moment of an environment as its render mode says.

    Args:
        mode: "rgb_array", a 3-D view; "fluoroscopy", the frontal image; "human", a window that shows the 3-D view, or
            the frontal image where OpenGL cannot draw; None: nothing.
        robot: that feeds the wire, or None.

    Raises:
        ValueError: an unknown mode.
    """

    def __init__(self, mode: str | None, fluoroscope: Fluoroscope, robot: FollowerRobot | None) -> None:
        if mode is not None and mode not in MODES:
            raise ValueError(f"unknown render_mode '{mode}'; there are {', '.join(MODES)}")
        self.mode = mode
        self._fluoroscope, self._robot = fluoroscope, robot
        self._view: View | None = None
        self._window: Window | None = Window() if mode == "human" else None
        self._flat = mode == "fluoroscopy"

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_view": None, "_window": None}  # what OpenGL and the screen hold stays where it is

    def picture(self, goal: np.ndarray) -> np.ndarray | None:
        """The picture of the moment, (height, width, 3) uint8, also in the mode "human"; None in no mode.

        Args:
            goal: target to mark in the 3-D view, m. Shape (3,).
        """
        if self.mode is None:
            return None
        if not self._flat and self._view is None:
            from cathsim.viewing.camera_view import RenderingUnavailableError, View

            try:
                self._view = View(self._fluoroscope.simulation.phantom, robot=self._robot)
            except RenderingUnavailableError:
                if self.mode != "human":
                    raise
                self._flat = True
        if self._view is not None:
            return self._view.render(self._fluoroscope.simulation, goal)
        return np.repeat(self._fluoroscope.image()[:, :, None], 3, axis=2)

    def show(self, goal: np.ndarray) -> None:
        """In the mode "human", shows the moment in the window; otherwise does nothing."""
        if self.mode == "human":
            picture = self.picture(goal)
            assert picture is not None
            self._window = self._window or Window()
            self._window.show(picture, self._fluoroscope.simulation.pace.interval)

    def close(self) -> None:
        """Frees the renderer and closes the window."""
        if self._view is not None:
            self._view.close()
            self._view = None
        if self._window is not None:
            self._window.close()


class Window:
    """A window that shows pictures at the speed of the simulated time.

    Raises:
        ImportError: pygame, which draws it, is not installed.
        RenderingUnavailableError: there is no screen.
    """

    def __init__(self) -> None:
        try:
            import pygame
        except ImportError:
            raise ImportError(
                "render_mode='human' needs pygame: pip install 'endonav-cathsim[human]'", name="pygame"
            ) from None
        self._pygame = pygame
        self._surface: Any = None
        self._clock = pygame.time.Clock()
        self._find_screen()

    def _find_screen(self) -> None:
        display, chosen = self._pygame.display, sys.platform == "linux" and _SDL_DRIVER not in os.environ
        screen = _screen_named()
        # Left to itself, SDL draws nowhere where there is no screen, and at its end takes EGL from everybody else.
        if chosen:
            os.environ[_SDL_DRIVER] = "x11,wayland"
        try:
            if screen:
                display.init()
        except self._pygame.error:
            screen = False
        finally:
            if chosen:
                del os.environ[_SDL_DRIVER]
        if not screen:
            from cathsim.viewing.camera_view import RenderingUnavailableError

            raise RenderingUnavailableError(
                "render_mode='human' needs a screen and none can be opened here: use render_mode='rgb_array' or "
                "'fluoroscopy', or set DISPLAY or WAYLAND_DISPLAY to a screen"
            )

    def show(self, picture: np.ndarray, interval: float = CONTROL_STEP) -> None:
        """Shows a picture (height, width, 3) uint8, after the last one has been seen for a control step, s."""
        pygame, factor = self._pygame, max(1, -(-LEAST_HEIGHT // len(picture)))
        if self._surface is None:
            pygame.display.set_caption("cathsim")
            self._surface = pygame.display.set_mode((factor * picture.shape[1], factor * picture.shape[0]))
        enlarged = picture.repeat(factor, axis=0).repeat(factor, axis=1)
        self._surface.blit(pygame.surfarray.make_surface(enlarged.transpose(1, 0, 2)), (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(1 / interval)

    def close(self) -> None:
        """Closes the window."""
        if self._pygame.display.get_init():
            self._pygame.display.quit()
        self._surface = None
