"""Composer entities: the vessel as arena, the feeder, and the guidewire that it holds."""

from __future__ import annotations

import copy
import ctypes
from dataclasses import dataclass
from xml.etree import ElementTree

import mujoco
import numpy as np
from dm_control import composer, mjcf
from dm_control.composer.define import observable
from dm_control.composer.observation.observable import MJCFFeature

from cathsim.anatomy import Phantom
from cathsim.contact.native import MAX_CONTACTS, Contacts, SimulationStruct, address, engine, library
from cathsim.contact.sdf import GEOM_NAME, Vessel
from cathsim.devices.arena import ADVANCE, FEEDER, PROTRUSION, ROTATE, max_insertion, model_spec
from cathsim.guidewire import LINK_NAME, TIP_SITE, Guidewire
from cathsim.presets import Accuracy
from cathsim.simulation import LEAD_ADVANCE, LEAD_ROTATION
from cathsim.viewing.camera_view import WALL

SKY = [0.97, 0.97, 0.98]


@dataclass(frozen=True)
class Parts:
    """MJCF of the three entities, each in its own frame."""

    arena: mjcf.RootElement  # options, and the dummy geoms that stand for the vessel
    # a body with the two joints and their servos, at the origin; +z is the direction of insertion
    feeder: mjcf.RootElement
    # the links, and the tip's motors if there are any; the first link begins at the origin, along +z
    guidewire: mjcf.RootElement


def model_parts(vessel: Vessel, wire: Guidewire, numerics: Accuracy, *, tip_motors: bool = False) -> Parts:
    """Parts of the model that `devices.arena.model_spec` describes, so that both environments share one description.

    The vessel must outlive every Physics made of the parts.
    """
    spec = model_spec(vessel, wire, numerics, tip_motors=tip_motors)
    spec.compile()  # MuJoCo writes XML of compiled specifications only
    whole = ElementTree.fromstring(spec.to_xml())
    world, actuators = _section(whole, "worldbody"), _section(whole, "actuator")
    body = world.find(f"body[@name='{FEEDER}']")
    assert body is not None
    links = [part for part in body if part.get("name", "").startswith(LINK_NAME.format(""))]
    servos = [part for part in actuators if part.get("name") in (ADVANCE, ROTATE)]
    motors = [part for part in actuators if part.get("name") not in (ADVANCE, ROTATE)]

    world.remove(body)
    whole.remove(actuators)
    for link in links:
        body.remove(link)
    body.attrib.pop("pos", None)
    body.attrib.pop("quat", None)
    return Parts(
        arena=_root(whole),
        feeder=_root(_document(whole, "feeder", [body], servos)),
        guidewire=_root(_document(whole, "guidewire", links, motors)),
    )


def _section(parent: ElementTree.Element, name: str) -> ElementTree.Element:
    section = parent.find(name)
    assert section is not None, name
    return section


def _document(
    whole: ElementTree.Element, name: str, world: list[ElementTree.Element], actuators: list[ElementTree.Element]
) -> ElementTree.Element:
    """A model of its own with the same compiler settings."""
    document = ElementTree.Element("mujoco", model=name)
    document.append(copy.deepcopy(_section(whole, "compiler")))
    ElementTree.SubElement(document, "worldbody").extend(world)
    if actuators:
        ElementTree.SubElement(document, "actuator").extend(actuators)
    return document


def _root(document: ElementTree.Element) -> mjcf.RootElement:
    return mjcf.from_xml_string(ElementTree.tostring(document, encoding="unicode"))


class VesselArena(composer.Entity):
    """The vessel and its sheath; contacts with them come from the signed-distance grid.

    Args:
        model: MJCF with the vessel's dummy geoms.
        vessel: what they stand for; kept as long as the arena.
        wire_length: m; the feeder is attached where a wire of this length just looks out of the sheath.
    """

    def _build(self, model: mjcf.RootElement, vessel: Vessel, wire_length: float) -> None:
        self._model, self.vessel = model, vessel
        quaternion = np.zeros(4)
        mujoco.mju_quatZ2Vec(quaternion, vessel.direction)
        base = vessel.entry - vessel.direction * (wire_length - PROTRUSION)
        self.feeder_site = model.worldbody.add("site", name="feeder", pos=base, quat=quaternion, group=5)
        self._geom = model.find("geom", GEOM_NAME)
        self._points, self._forces = np.zeros((MAX_CONTACTS, 3)), np.zeros((MAX_CONTACTS, 3))

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        """Its MJCF."""
        return self._model

    def show(self, phantom: Phantom) -> None:
        """Adds what a renderer needs: the lumen's surface, translucent, and a camera "frontal" that sees all of it."""
        root, bounds = self._model, phantom.bounds
        root.visual.headlight.set_attributes(ambient=[0.45] * 3, diffuse=[0.55] * 3)
        root.visual.map.set_attributes(znear=0.01, zfar=10.0)
        root.statistic.set_attributes(extent=0.3, center=bounds.mean(axis=0))
        contents = phantom.lumen_mesh.export(file_type="stl")
        mesh = root.asset.add("mesh", name="lumen", file=mjcf.Asset(contents, ".stl"), inertia="shell")
        root.asset.add("texture", type="skybox", builtin="flat", rgb1=SKY, rgb2=SKY, width=16, height=96)
        root.worldbody.add("geom", type="mesh", mesh=mesh, rgba=WALL, contype=0, conaffinity=0, mass=0)
        distance = 1.45 * (bounds[1, 2] - bounds[0, 2])
        place = bounds.mean(axis=0) - [0, distance, 0]
        root.worldbody.add("camera", name="frontal", pos=place, xyaxes=[1, 0, 0, 0, 0, 1], fovy=45)

    def contacts(self, physics: mjcf.Physics) -> Contacts:
        """Contacts between wire and lumen in the last substep; those in the sheath are left out."""
        struct = SimulationStruct(
            model=physics.model.ptr._address,
            data=physics.data.ptr._address,
            vessel_geom=physics.bind(self._geom).element_id,
        )
        count = library().cathsim_contact_forces(
            ctypes.byref(struct), ctypes.byref(engine()), MAX_CONTACTS, address(self._points), address(self._forces)
        )
        return Contacts(self._points[:count].copy(), self._forces[:count].copy())


def set_controls(physics: mjcf.Physics, actuators: list[mjcf.Element], values: np.ndarray) -> None:
    """Sets controls (n,), without marking the physics as changed: that would cost a forward pass at the next look."""
    physics.data.ctrl[physics.bind(actuators).element_id] = values


class FeederObservables(composer.Observables):
    """Measurements of an encoder in the feeder."""

    @observable
    def position(self) -> MJCFFeature:
        """Advance (m) and rotation (rad). Shape (2,)."""
        return MJCFFeature("qpos", self._entity.joints)

    @observable
    def velocity(self) -> MJCFFeature:
        """Rates of the position (m/s, rad/s). Shape (2,)."""
        return MJCFFeature("qvel", self._entity.joints)


class Feeder(composer.Entity):
    """Advances and rotates the wire's proximal end along the sheath's axis, by servos of limited force.

    Args:
        model: MJCF with two joints and their servos.
        wire: how far it can be fed is the feeder's travel.
    """

    def _build(self, model: mjcf.RootElement, wire: Guidewire) -> None:
        self._model = model
        self.joints = [model.find("joint", name) for name in (ADVANCE, ROTATE)]
        self.servos = [model.find("actuator", name) for name in (ADVANCE, ROTATE)]
        self.body = model.find("body", FEEDER)
        self.wire_site = self.body.add("site", name="wire", group=5)
        self.travel = max_insertion(wire)
        self._from, self._to = np.zeros(2), np.zeros(2)

    def _build_observables(self) -> FeederObservables:
        return FeederObservables(self)

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        """Its MJCF."""
        return self._model

    def place(self, physics: mjcf.Physics, insertion: float, rotation: float) -> None:
        """Moves the wire at once to an insertion (m) and a rotation (rad); the physics is just reset."""
        physics.bind(self.joints).qpos = insertion, rotation
        self._from[:] = self._to[:] = insertion, rotation

    def reach(self, physics: mjcf.Physics) -> tuple[float, float]:
        """Least and most that its drive, whose force is limited, can move in a control step, m."""
        ahead = float(self._to[0]) - float(np.asarray(physics.bind(self.joints).qpos)[0])
        return -LEAD_ADVANCE - ahead, LEAD_ADVANCE - ahead

    def command(self, physics: mjcf.Physics, translation: float, rotation: float) -> None:
        """Sets the target of the coming control step; it never runs further ahead than the force limit can use.

        Args:
            translation: m.
            rotation: rad.
        """
        at = np.asarray(physics.bind(self.joints).qpos, float)
        self._from[:] = self._to
        reach = np.array([LEAD_ADVANCE, LEAD_ROTATION])
        self._to[:] = at + np.clip(self._to + np.array([translation, rotation]) - at, -reach, reach)
        self._to[0] = np.clip(self._to[0], 0.0, self.travel)

    def drive(self, physics: mjcf.Physics, share: float) -> None:
        """Sets the servos for a substep.

        Args:
            share: of the control step that has passed at the substep's end, 0 to 1.
        """
        set_controls(physics, self.servos, self._from + share * (self._to - self._from))


class GuidewireObservables(composer.Observables):
    """The wire's shape, in joints and in space."""

    @observable
    def joint_positions(self) -> MJCFFeature:
        """Two angles (rad) a joint, from the proximal end. Shape (2 joints,)."""
        return MJCFFeature("qpos", self._entity.joints)

    @observable
    def joint_velocities(self) -> MJCFFeature:
        """Their rates (rad/s). Shape (2 joints,)."""
        return MJCFFeature("qvel", self._entity.joints)

    @observable
    def tip(self) -> MJCFFeature:
        """Position of the tip, m, world frame. Shape (3,)."""
        return MJCFFeature("xpos", self._entity.tip_site)


class GuidewireEntity(composer.Entity):
    """The wire: a chain of capsules, with motors in its tip if the model has any."""

    def _build(self, model: mjcf.RootElement, wire: Guidewire) -> None:
        self._model, self.wire = model, wire
        self.links = [model.find("body", LINK_NAME.format(index)) for index in range(1, len(wire.links))]
        self.joints = [joint for link in self.links for joint in link.joint]
        self.tip_site = model.find("site", TIP_SITE)
        self.motors = model.find_all("actuator")

    def _build_observables(self) -> GuidewireObservables:
        return GuidewireObservables(self)

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        """Its MJCF."""
        return self._model

    def bend(self, physics: mjcf.Physics, shares: np.ndarray) -> None:
        """Sets the tip's motors to shares (motors,) of their range, -1 to 1."""
        set_controls(physics, self.motors, shares * np.asarray(physics.bind(self.motors).ctrlrange)[:, 1])

    def nodes(self, physics: mjcf.Physics) -> np.ndarray:
        """Ends of the links from the tip to the proximal end, m, world frame. Shape (links + 1, 3)."""
        tip = np.asarray(physics.bind(self.tip_site).xpos)
        joints = np.asarray(physics.bind(self.links).xpos)
        root = np.asarray(physics.bind(self.root_body).xpos)
        return np.concatenate((tip[None], joints[::-1], root[None]))
