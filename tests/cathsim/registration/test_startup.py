"""What `import cathsim` and the making of environments pull in."""

import json
from collections.abc import Callable

LEARNING = {"torch", "dm_control", "stable_baselines3", "matplotlib", "OpenGL", "trimesh", "skimage", "cv2"}


def test_an_import_and_the_making_of_environments_stay_light(run_python: Callable[[str], str]) -> None:
    snippet = (
        "import os; os.environ.pop('MUJOCO_GL', None)\n"  # with it, MuJoCo itself imports OpenGL
        "import cathsim, json, sys\n"
        "loaded = [[*sys.modules]]\n"
        "import gymnasium; gymnasium.make('cathsim/Navigate-v0')\n"
        "loaded.append([*sys.modules])\n"
        "env = cathsim.NavigateEnv(accuracy='fast', observation=('internal', 'image'))\n"
        "env.reset(seed=0); env.step(env.action_space.sample())\n"
        "print(json.dumps([*loaded, [*sys.modules]]))"
    )
    imported, made, seen = (set(modules) for modules in json.loads(run_python(snippet)))
    assert not (LEARNING | {"mujoco", "scipy"}) & {name.split(".")[0] for name in imported}
    ours = {name for name in imported if name.startswith("cathsim.")}
    assert "cathsim.registration" in ours
    assert not ours - {"cathsim.registration", "cathsim.lazy_names"}
    assert sum(name.split(".")[0] == "cathsim" for name in made) <= 90
    assert not {"scipy", "skimage", "trimesh", "cathsim.fluoroscopy", "cathsim.anatomy.importing"} & made
    assert "mujoco" in seen
    assert not LEARNING & {name.split(".")[0] for name in seen}
