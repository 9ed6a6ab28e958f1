"""The simulator's MuJoCo model, cut into the three that composer joins again: vessel, feeder, wire."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from xml.etree import ElementTree

from dm_control import mjcf

from cathsim.contact.sdf import Vessel
from cathsim.devices.arena import ADVANCE, FEEDER, ROTATE, model_spec
from cathsim.guidewire import LINK_NAME, Guidewire
from cathsim.presets import Accuracy


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
    found = parent.find(name)
    assert found is not None, name
    return found


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
