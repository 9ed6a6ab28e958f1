"""Recipes of generated arches: by name and seed, as JSON and back."""

import json

import pytest

from cathsim.anatomy import ArchParameters
from cathsim.anatomy.generator.recipe import RANDOM, draw_recipe, recipe_content, recipe_of
from cathsim.anatomy.generator.variety_arch import VarietyArch, drawn_type


@pytest.mark.parametrize("name", RANDOM)
def test_a_recipe_comes_back_from_json(name):
    recipe = draw_recipe(name, 5)
    assert recipe_of(json.loads(json.dumps(recipe_content(recipe)))) == recipe


def test_a_type_is_drawn_or_named():
    assert draw_recipe("arch_variety", 7) == VarietyArch(drawn_type(7), 7)
    assert draw_recipe("arch_variety_VI", 7) == VarietyArch("VI", 7)
    assert isinstance(draw_recipe("random", 7), ArchParameters)
