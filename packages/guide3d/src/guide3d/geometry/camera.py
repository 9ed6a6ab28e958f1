"""A calibrated X-ray camera: the pinhole K [R | t] with its covariance, and the text files that hold it.

World millimetres; pixels with (0, 0) in the centre of the top-left one, x right and y down. The source is the
pinhole; z runs from the source to the detector.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import scipy.linalg

from guide3d.files import numbers_in, read_text, whole_file
from guide3d.setting_kinds import Numbers, Pixels, settings

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}


@settings(eq=False)
class Camera:
    """One view: x ~ K (R X + t).

    K: (3, 3) px, upper triangular, with skew in K[0, 1]
    R: (3, 3) world directions into the camera frame
    t_mm: (3,) the world's origin in the camera frame, mm
    width, height: of the image, px
    covariance: (11, 11) of (fx, fy, skew, cx, cy in px; a small rotation in the camera frame in rad; t in mm), or None
    """

    K: Numbers
    R: Numbers
    t_mm: Numbers
    width: Pixels
    height: Pixels
    name: str = ""
    covariance: Numbers | None = None

    def __post_init__(self) -> None:
        for field, shape in (("K", (3, 3)), ("R", (3, 3)), ("t_mm", (3,)), ("covariance", (11, 11))):
            value = getattr(self, field)
            if value is None and field == "covariance":
                continue
            value = np.asarray(value, float)
            if value.shape != shape or not np.isfinite(value).all():
                problem = f"shape {value.shape}" if value.shape != shape else "values that are not finite"
                raise ValueError(f"{self._who()}: {field} should be {shape} of finite numbers, found {problem}")
            value = value.copy()
            value.flags.writeable = False
            object.__setattr__(self, field, value)
        spread = self.covariance
        if spread is not None:
            # each variance on its own scale: angles beside pixels
            scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
            relative = spread / scale[:, None] / scale
            if np.diag(spread).min() < 0 or abs(relative - relative.T).max() > 1e-6 or (
                np.linalg.eigvalsh(relative).min() < -1e-6
            ):  # fmt: skip
                raise ValueError(f"{self._who()}: covariance should be symmetric without a negative variance")
        triangular = abs(self.K[2] - [0.0, 0.0, 1.0]).max() <= 1e-9 and abs(self.K[1, 0]) <= 1e-9
        if not triangular or min(self.K[0, 0], self.K[1, 1]) <= 0:
            raise ValueError(
                f"{self._who()}: K should be upper triangular with positive focal lengths and a last row 0 0 1, "
                f"found {self.K.tolist()}"
            )
        if abs(self.R @ self.R.T - np.eye(3)).max() > 1e-4 or np.linalg.det(self.R) < 0:
            raise ValueError(
                f"{self._who()}: R should be a rotation (orthonormal, determinant +1), found {self.R.tolist()}"
            )

    def _who(self) -> str:
        return f"camera {self.name}" if self.name else "camera"

    @property
    def P(self) -> np.ndarray:
        """The projection matrix (3, 4): homogeneous world millimetres to homogeneous pixels."""
        return self.K @ np.column_stack([self.R, self.t_mm])

    @property
    def centre_mm(self) -> np.ndarray:
        """The X-ray source (3,) in the world, mm."""
        return -self.R.T @ self.t_mm

    def depth_mm(self, points_mm: np.ndarray) -> np.ndarray:
        """Distance (...) of points (..., 3) in world mm along the optical axis, positive towards the detector."""
        return np.asarray(points_mm, float) @ self.R[2] + self.t_mm[2]

    def project(self, points_mm: np.ndarray) -> np.ndarray:
        """Pixels (..., 2), undistorted, of points (..., 3) in the world, mm.

        Raises:
            ValueError: The points are not three-dimensional.
        """
        points_mm = np.asarray(points_mm, float)
        if points_mm.shape[-1:] != (3,):
            raise ValueError(f"{self._who()}: expected points of shape (..., 3) in mm, found {points_mm.shape}")
        seen = points_mm @ (self.K @ self.R).T + self.K @ self.t_mm
        return seen[..., :2] / seen[..., 2:]

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Unit directions in the world (..., 3), from the source through undistorted pixels (..., 2)."""
        pixels = np.asarray(pixels, float)
        homogeneous = np.concatenate([pixels, np.ones((*pixels.shape[:-1], 1))], axis=-1)
        directions = homogeneous @ (self.R.T @ np.linalg.inv(self.K)).T
        return directions / np.linalg.norm(directions, axis=-1, keepdims=True)

    def contains(self, pixels: np.ndarray, margin_px: float = 0.5) -> np.ndarray:
        """Whether pixels (..., 2) lie in the image or up to `margin_px` beyond the outer pixel centres, bool (...)."""
        pixels = np.asarray(pixels, float)
        inside = (pixels >= -margin_px) & (pixels <= np.array([self.width, self.height]) - 1 + margin_px)
        return np.asarray(inside.all(axis=-1))

    @classmethod
    def from_P(cls, P: np.ndarray, width: int, height: int, name: str = "") -> Camera:
        """The camera of a projection matrix, by RQ decomposition, without a covariance.

        Args:
            P: (3, 4), any scale and sign, world mm to px.
            width, height: Of the image, px.

        Raises:
            ValueError: P has another shape or no finite centre.
        """
        P = np.asarray(P, float)
        if P.shape != (3, 4) or not np.isfinite(P).all():
            raise ValueError(f"expected a projection matrix (3, 4) of finite numbers, found shape {P.shape}")
        scale = np.cbrt(np.linalg.det(P[:, :3]))
        if abs(scale) <= 1e-12 * np.abs(P[:, :3]).max():
            raise ValueError("the projection matrix has no finite centre: its left 3 x 3 block is singular")
        P = P / scale  # determinant +1, so that R is proper
        K, R = scipy.linalg.rq(P[:, :3])
        signs = np.diag(np.sign(np.diag(K)))
        K, R = K @ signs, signs @ R
        return cls(K / K[2, 2], R, np.linalg.solve(K, P[:, 3]), width, height, name)


def read_camera(path: str | Path, unit: str = "cm") -> Camera:
    """Read the text file that XMALab exports: image size, camera matrix, rotation, translation, a row a line.

    Args:
        path: The file; its stem becomes the camera's name.
        unit: World unit of the file ("mm", "cm" or "m").

    Returns:
        The camera in millimetres, without a covariance.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: A section is missing or malformed; the message names file, expected and found.
    """
    path, scale = Path(path), _scale_mm(unit)
    text = read_text(path, "camera file")
    lines = [line.strip(' \t;,"') for line in text.splitlines()]
    separator = next((mark for mark in ";\t" if mark in text), "")  # a comma in a row of one number is then decimal

    def section(title: str, rows: int, columns: int) -> np.ndarray:
        if title not in lines:
            content = ", ".join(repr(line) for line in lines if re.fullmatch(r"[a-zA-Z ]{1,40}", line))[:200] or "none"
            raise ValueError(f"{path}: expected a section {title!r}, found sections: {content}")
        start = lines.index(title) + 1
        body = lines[start : start + rows]
        values = [row for line in body if (row := numbers_in(line + separator)) is not None]
        if len(values) != rows or any(len(row) != columns for row in values):
            content = " | ".join(body)[:200] or "nothing"
            raise ValueError(f"{path}: expected {rows} x {columns} numbers under {title!r}, found {content!r}")
        return np.array(values)

    size = section("image size", 1, 2)[0]
    K, R, t = section("camera matrix", 3, 3), section("rotation", 3, 3), section("translation", 3, 1)[:, 0]
    return _built(path, K, R, t * scale, size, path.stem)


def write_camera(camera: Camera, path: str | Path, unit: str = "cm") -> None:
    """Write a camera as XMALab does (skew stands in the camera matrix; the format holds no covariance).

    Args:
        camera: The camera, mm.
        path: The file to write; it appears whole or not at all.
        unit: World unit of the file ("mm", "cm" or "m").
    """
    t = camera.t_mm / _scale_mm(unit)
    blocks: list[tuple[str, Iterable[Iterable[float]]]] = [
        ("image size", [[camera.width, camera.height]]),
        ("camera matrix", camera.K),
        ("rotation", camera.R),
        ("translation", t[:, None]),
    ]
    text = []
    for title, rows in blocks:
        text.append(f"{title}\r\n" + "".join(",".join(f"{value:.15g}" for value in row) + "\r\n" for row in rows))
    with whole_file(path, "w") as file:
        file.write("\r\n".join(text))


_YAML_NAMES = {
    "K": ("camera_matrix", "K", "M", "cameraMatrix", "Camera_Matrix"),
    "R": ("rotation_matrix", "R", "rotation"),
    "t": ("translation_vector", "t", "T", "translation", "tvec"),
    "size": ("image_width", "image_height"),
    "covariance": ("covariance",),
}
_LENS = re.compile(r"^((?:(?!\w*distance)\w*(?i:dist)\w*|D\d*|k\d|kc)):((?:.*\n?)(?:(?:[ \t-].*)?\n)*)", re.MULTILINE)
_TEXT = r"""\s*(["']?)([^"'#\n]*?)\1\s*(?:#.*)?$"""


def read_opencv_yaml(path: str | Path, unit: str | None = None) -> Camera:
    """Read a camera from a YAML file as OpenCV's FileStorage writes them.

    Args:
        path: The file; its stem becomes the camera's name unless it holds `camera_name`.
        unit: World unit of the translation; None takes the file's own `world_unit`, or mm.

    Returns:
        The camera in millimetres, with the covariance when the file has one.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: An entry is missing or malformed, the unit is unknown, or there is lens distortion.
    """
    path = Path(path)
    text = read_text(path, "camera file")

    def matrix(kind: str, shape: tuple[int, int]) -> np.ndarray | None:
        for name in _YAML_NAMES[kind]:
            pattern = rf"^{name}:\s*!!opencv-matrix\s*rows:\s*(\d+)\s*cols:\s*(\d+)\s*dt:\s*\S+\s*data:\s*\[([^\]]*)\]"
            match = re.search(pattern, text, re.MULTILINE)
            if match is None:
                continue
            rows, columns = int(match[1]), int(match[2])
            cells = match[3].split(",")
            try:
                values = np.array([float(cell) for cell in cells])
            except ValueError:
                values = np.empty(0)
            if values.size != rows * columns or values.size != shape[0] * shape[1]:
                content = f"{rows} x {columns} declared, {match[3].strip()[:60]!r} written"
                raise ValueError(f"{path}: expected {shape[0]} x {shape[1]} numbers in {name}, found {content}")
            return values.reshape(shape)
        return None

    K, R, t = matrix("K", (3, 3)), matrix("R", (3, 3)), matrix("t", (3, 1))
    sizes = [re.search(rf"^{name}:\s*(\d+)\s*$", text, re.MULTILINE) for name in _YAML_NAMES["size"]]
    if K is None or R is None or t is None:
        missing = next(kind for value, kind in ((K, "K"), (R, "R"), (t, "t")) if value is None)
        first, *others = _YAML_NAMES[missing]
        raise ValueError(f"{path}: expected an !!opencv-matrix {first} (or {', '.join(others)}), found none")
    if sizes[0] is None or sizes[1] is None:
        raise ValueError(f"{path}: expected image_width and image_height as whole numbers, found at most one of them")
    for key, value in _LENS.findall(text + "\n"):
        coefficients = numbers_in(" ".join(re.findall(r"[^\s,\[\]]*\d[^\s,\[\]]*", value.rpartition("[")[2]))) or [0.0]
        if any(coefficients):
            raise ValueError(
                f"{path}: expected no lens distortion, found {key} {coefficients}; "
                "undistort the points first (guide3d.geometry.distortion)"
            )
    text_of = {
        key: match[2]
        for key, pattern in (("world_unit", "(?i:world_?)?(?i:units?)"), ("camera_name", "camera_name"))
        if (match := re.search(f"^{pattern}:{_TEXT}", text, re.MULTILINE))
    }
    try:
        scale = _scale_mm(unit or text_of.get("world_unit", "mm").lower())
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    size = np.array([float(sizes[0][1]), float(sizes[1][1])])
    name = text_of.get("camera_name", path.stem)
    return _built(path, K, R, t[:, 0] * scale, size, name, matrix("covariance", (11, 11)))


def write_opencv_yaml(camera: Camera, path: str | Path, unit: str = "mm") -> None:
    """Write a camera as YAML that OpenCV's FileStorage reads.

    OpenCV's own projectPoints ignores the skew in K[0, 1]; its P-matrix functions (triangulatePoints) honour it.

    Args:
        camera: The camera, mm; its covariance is written too, always for millimetres.
        path: The file to write; it appears whole or not at all.
        unit: World unit of the translation, written as `world_unit`.
    """
    matrices = {
        "camera_matrix": camera.K,
        "distortion_coefficients": np.zeros((1, 5)),
        "rotation_matrix": camera.R,
        "translation_vector": camera.t_mm[:, None] / _scale_mm(unit),
    }
    if camera.covariance is not None:
        matrices["covariance"] = camera.covariance
    text = "%YAML:1.0\n---\n"
    if camera.name:
        text += f'camera_name: "{camera.name}"\n'
    text += f'image_width: {camera.width}\nimage_height: {camera.height}\nworld_unit: "{unit}"\n'
    for name, value in matrices.items():
        rows = ",\n      ".join(", ".join(_yaml_number(v) for v in row) for row in value)
        shape = f"   rows: {value.shape[0]}\n   cols: {value.shape[1]}\n"
        text += f"{name}: !!opencv-matrix\n{shape}   dt: d\n   data: [ {rows} ]\n"
    with whole_file(path, "w") as file:
        file.write(text)


def _yaml_number(value: float) -> str:
    digits = f"{value:.16g}"
    # a point, as OpenCV writes it, tells a real number from an integer
    return digits if any(mark in digits for mark in ".en") else digits + "."


def _scale_mm(unit: str) -> float:
    if unit not in UNITS_MM:
        raise ValueError(f"expected a unit among {', '.join(UNITS_MM)}, found {unit!r}")
    return UNITS_MM[unit]


def _built(
    path: Path,
    K: np.ndarray,
    R: np.ndarray,
    t_mm: np.ndarray,
    size: np.ndarray,
    name: str,
    covariance: np.ndarray | None = None,
) -> Camera:
    width, height = size.tolist()
    try:
        return Camera(K, R, t_mm, width=width, height=height, name=name, covariance=covariance)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
