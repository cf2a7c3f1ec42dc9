"""A load from a file: what it weighs, and where its cables are."""

import numpy as np
import pytest

from drake_nonstop import (
    ScenarioError,
    changed,
    dump_scenario,
    load_scenario,
    parse_scenario,
    simulate,
)

FRAMES = ["north", "west", "south", "east"]
POINTS = np.array([[0.1, 0.7, 0.2], [-0.6, 0.1, 0.2], [0.1, -0.5, 0.2], [0.8, 0.1, 0.2]])


def sdf(extra="", centre="0.1 0.1 0.05"):
    frames = "".join(
        f'<frame name="{name}"><pose>{x} {y} {z} 0 0 0</pose></frame>'
        for name, (x, y, z) in zip(FRAMES, POINTS, strict=True)
    )
    return f"""<?xml version="1.0"?><sdf version="1.7"><model name="crate">
    <link name="crate"><inertial><mass>1.2</mass><pose>{centre} 0 0 0</pose><inertia>
    <ixx>0.02</ixx><iyy>0.03</iyy><izz>0.04</izz><ixy>0.001</ixy><ixz>0</ixz><iyz>0</iyz>
    </inertia></inertial></link>{frames}{extra}</model></sdf>"""


URDF = """<robot name="crate"><link name="crate"><inertial><mass value="1.2"/>
<inertia ixx="0.02" iyy="0.03" izz="0.04"/></inertial></link></robot>"""


FOOT = """<link name="foot"/><joint name="weld" type="fixed"><parent>crate</parent>
<child>foot</child></joint>"""


@pytest.fixture
def loaded(tmp_path):
    """What makes the system of a file, and its path."""

    def load(text, frames=FRAMES):
        path = tmp_path / f"load.{'urdf' if '<robot' in text else 'sdf'}"
        path.write_text(text)
        changes = [f"system.load_file={path}", f"system.attachment_frames=[{', '.join(frames)}]"]
        return load_scenario("quintic", [*changes, "optimization_layer=ConstantParameters"])

    return load


def test_mass_inertia_and_attachments_are_about_the_centre_of_mass(loaded):
    system = loaded(sdf()).system
    assert system.load_mass == 1.2
    inertia = [[0.02, 0.001, 0], [0.001, 0.03, 0], [0, 0, 0.04]]
    np.testing.assert_allclose(system.load_inertia, inertia, atol=1e-12)
    np.testing.assert_allclose(system.attachments, POINTS - [0.1, 0.1, 0.05], atol=1e-12)


def test_welded_bodies_are_one_load(loaded):
    block = """<link name="block"><pose>0 0 1 0 0 0</pose><inertial><mass>1.2</mass>
    <inertia><ixx>0.02</ixx><iyy>0.03</iyy><izz>0.04</izz></inertia></inertial></link>
    <joint name="weld" type="fixed"><parent>crate</parent><child>block</child></joint>"""
    system = loaded(sdf(block, centre="0 0 0")).system
    assert system.load_mass == pytest.approx(2.4)
    np.testing.assert_allclose(system.attachments, POINTS - [0, 0, 0.5], atol=1e-12)
    # Two bodies 0.5 m from their common centre: m r² each on top of their own.
    assert system.load_inertia[0][0] == pytest.approx(2 * (0.02 + 1.2 * 0.25))


def test_urdf_too(loaded):
    links = "".join(
        f'<link name="{name}"/><joint name="j{name}" type="fixed"><parent link="crate"/>'
        f'<child link="{name}"/><origin xyz="{x} {y} {z}"/></joint>'
        for name, (x, y, z) in zip(FRAMES, POINTS, strict=True)
    )
    system = loaded(URDF.replace("</robot>", f"{links}</robot>")).system
    assert system.load_mass == pytest.approx(1.2)
    np.testing.assert_allclose(system.attachments, POINTS, atol=1e-12)


@pytest.mark.parametrize("plant", ["LoadPlant", "MultibodyLoadPlant"])
def test_a_scenario_flies_a_load_from_a_file(loaded, plant):
    scenario = changed(loaded(sdf()), [f"load_plant=!{plant} {{}}", "simulation_duration=0.2"])
    assert parse_scenario(dump_scenario(scenario)).system == scenario.system
    run = simulate(scenario)
    assert np.linalg.norm(run.signal("tracking_error")[:, 3:6], axis=1).max() < 1e-3


HINGED = """<link name="arm"><inertial><mass>1</mass></inertial></link>
<joint name="hinge" type="revolute"><parent>crate</parent><child>arm</child>
<axis><xyz>0 0 1</xyz></axis></joint>"""
# A text of the SDF, or of the URDF, and one in its place that Drake may make some load of.
CHANGED = [
    ("<mass>1.2", "<mass>-1.2", "link crate, <mass> = -1.2: give a number above zero"),
    ("<mass>1.2</mass>", "", "link crate, <mass> = 0 of them: give one"),
    ("<mass>1.2</mass>", "<mass>1.2</mass><mass>2</mass>", "<mass> = 2 of them"),
    ("<mass>1.2", "<mass>2,5", "link crate, <mass> = '2,5': give finite numbers"),
    ("<mass>1.2", "<mass>nan", "<mass> = 'nan': give finite numbers"),
    ("<izz>0.04", "<izz>0.06", "link crate, <inertia> = [[0.02, 0.001, 0.0], "),
    ("<izz>0.04</izz>", "", "<izz> = nothing: give a number"),
    ("0.1 0.1 0.05", "0,1 0.1 0.05", "<pose> = '0,1 0.1 0.05 0 0 0': give finite"),
    ("</link>", f"</link>{FOOT}", "link foot, <inertial> = 0 of them: give one"),
    ('izz="0.04"', 'izz="0.06"', "link crate, <inertia> = [[0.02, 0.0, 0.0], "),
    (' izz="0.04"', "", "link crate, <izz> = nothing: give a number"),
    ('ixx="0.02"', 'ixx="0,02"', "link crate, <inertia> = '0,02': give finite numbers"),
]


def changed_text(old, new):
    text = URDF if '="' in old else sdf()
    assert text.count(old) == 1
    return text.replace(old, new)


@pytest.mark.parametrize(
    ("text", "frames", "told"),
    [
        ("nonsense", FRAMES, "give an SDF or URDF file"),
        (sdf(), ["north", "up"], "attachment_frames = up: give frames that"),
        (sdf(HINGED), FRAMES, "7 degrees of freedom"),
        *((changed_text(old, new), [], told) for old, new, told in CHANGED),
    ],
)
def test_a_file_that_is_no_load_is_reported_in_a_sentence(loaded, text, frames, told):
    with pytest.raises(ScenarioError) as caught:
        loaded(text, frames)
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("role", ["visual", "collision"])
@pytest.mark.parametrize("face", ["1 2 7", "1 2 -4", "1/1/1 2/1/1 3/1/900000000", "1 2 0", "a b c"])
def test_a_mesh_with_a_face_out_of_range_is_refused_and_ends_no_process(
    loaded, tmp_path, face, role
):
    mesh = f"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nvt 0 0\nf 1 2 3\nf {face}\n"
    (tmp_path / "crate.obj").write_text(mesh)
    shape = "<geometry><mesh><uri>crate.obj</uri></mesh></geometry>"
    text = sdf().replace("</link>", f'<{role} name="mesh">{shape}</{role}></link>', 1)
    with pytest.raises(ScenarioError, match=r"face = f .*: give .*line 7 .*crate\.obj .*1 to "):
        loaded(text)
