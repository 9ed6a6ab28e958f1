"""What `import cathsim` pulls in, and how Gymnasium finds the environment."""

import json
from collections.abc import Callable


def test_import_stays_light(run_python: Callable[[str], str]) -> None:
    loaded = set(json.loads(run_python("import cathsim, json, sys; print(json.dumps(sorted(sys.modules)))")))
    assert "cathsim.registration" in loaded
    heavy = {
        "torch",
        "dm_control",
        "stable_baselines3",
        "matplotlib",
        "OpenGL",
        "trimesh",
        "skimage",
        "mujoco",
        "scipy",
        "cv2",
    }
    assert not heavy & {name.split(".")[0] for name in loaded}
    assert not {name for name in loaded if name.startswith("cathsim.")} - {"cathsim.registration", "cathsim.lazy_names"}


def test_an_environment_needs_no_learning_library(run_python: Callable[[str], str]) -> None:
    snippet = (
        "import os; os.environ.pop('MUJOCO_GL', None)\n"  # with it, MuJoCo itself imports OpenGL
        "import cathsim, json, sys\n"
        "env = cathsim.NavigateEnv(accuracy='fast', observation=('internal', 'image'))\n"
        "env.reset(seed=0); env.step(env.action_space.sample())\n"
        "print(json.dumps(sorted({name.split('.')[0] for name in sys.modules})))"
    )
    loaded = set(json.loads(run_python(snippet)))
    assert "mujoco" in loaded
    assert (
        not {"torch", "dm_control", "stable_baselines3", "matplotlib", "OpenGL", "trimesh", "skimage", "cv2"} & loaded
    )


def test_an_environment_without_images_loads_no_importer_and_no_fluoroscope(run_python: Callable[[str], str]) -> None:
    snippet = (
        "import cathsim, gymnasium, json, sys; gymnasium.make('cathsim/Navigate-v0'); print(json.dumps([*sys.modules]))"
    )
    loaded = json.loads(run_python(snippet))
    assert sum(name.split(".")[0] == "cathsim" for name in loaded) <= 90
    assert not {"scipy", "skimage", "trimesh", "cathsim.fluoroscopy", "cathsim.anatomy.importing"} & set(loaded)
