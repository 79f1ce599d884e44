"""Opens a cache in Blender with a soap film's material: runs in Blender, with nothing of this package but two tables.

`write_script` puts a copy of this file beside a cache, with colours of films and the light of a studio:

    blender --python out/small/film_blender.py
    python out/small/film_blender.py --render frame.png --frame 30      # with the module bpy from the package index
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

import numpy as np

SCRIPT, TABLES = "film_blender.py", "film_blender.npz"
LARGEST = 4000.0
"""Thickness of the last row of the table, nm."""

EXPOSURE = 13.0
"""Strength of the light, as a film reflects less than 8 percent of it."""

GROUP = "Soap film"


def write_script(folder: Path) -> Path:
    """Put this file and its tables beside a cache.

    Raises:
        OSError: the files cannot be written.
    """
    from melp_warp.files import replacing
    from melp_warp.optics import color_table
    from melp_warp.preview.surface import light_table

    colors = color_table(LARGEST, 1024, 64).astype(np.float16)
    light = light_table("studio", "cpu").numpy()
    light = light.reshape(len(light) // 4, 4, -1, 4, 3).mean(axis=(1, 3)).astype(np.float16)
    with replacing(folder / TABLES) as partial, open(partial, "wb") as file:
        np.savez_compressed(file, colors=colors, light=light)
    with replacing(folder / SCRIPT) as partial:
        partial.write_text(Path(__file__).read_text(encoding="utf-8"), encoding="utf-8")
    return folder / SCRIPT


# --- in Blender ------------------------------------------------------------------------------------------------------


def open_cache(folder: Path, points: bool = False) -> list:
    """Import a cache into the present scene, at its speed, with its material.

    Args:
        folder: of the cache.
        points: whether to import the particles, too.

    Returns:
        The objects that are meshes or points.
    """
    import bpy

    before = set(bpy.data.objects)
    stage = folder / "film_stage.usda"
    root = stage if stage.is_file() else folder / "film.usda"
    bpy.ops.wm.usd_import(
        filepath=str(root), import_guide=points, import_lights=False, create_world_material=False, set_frame_range=True
    )
    set_speed(bpy.context.scene, rate_of(folder / "film.usda"))
    made = [one for one in bpy.data.objects if one not in before]
    tables = np.load(folder / TABLES)
    material = film_material(tables["colors"])
    shown = [one for one in made if one.type in ("MESH", "POINTCLOUD")]
    for one in shown:
        one.data.materials.clear()
        one.data.materials.append(material)
    cameras = [one for one in made if one.type == "CAMERA"]
    if cameras:
        bpy.context.scene.camera = cameras[0]
        set_light(bpy.context.scene, tables["light"].astype(np.float32))
    return shown


def rate_of(root: Path) -> float:
    """Frames per second of a cache, which Blender's importer leaves aside."""
    return float(re.search(r"framesPerSecond = ([0-9.e+-]+)", root.read_text(encoding="utf-8"))[1])


def set_speed(scene, rate: float) -> None:
    """Make a frame of the scene last as long as one of the cache, so that motion blur takes velocities right."""
    scene.render.fps = max(1, round(rate))
    scene.render.fps_base = scene.render.fps / rate


def set_light(scene, light: np.ndarray) -> None:
    """Light the scene by a studio about its camera, as previews are, before a dark ground.

    Args:
        scene: with a camera.
        light: radiance from all directions in the camera's axes, on an octahedron that is laid flat.
    """
    import bpy

    axes = np.array(scene.camera.matrix_world.to_3x3())
    around, up = np.meshgrid((np.arange(1024) + 0.5) / 1024, (np.arange(512) + 0.5) / 512)
    turn, rise = (0.5 - around) * 2.0 * np.pi, (up - 0.5) * np.pi
    d = np.stack([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)], axis=-1) @ axes
    d /= np.abs(d).sum(axis=-1, keepdims=True)
    u, v = d[..., 0], d[..., 1]
    folded = [(1.0 - np.abs(b)) * np.where(a < 0.0, -1.0, 1.0) for a, b in ((u, v), (v, u))]
    u, v = (np.where(d[..., 2] < 0.0, a, b) for a, b in zip(folded, (u, v), strict=True))
    row, column = (np.clip(((x + 1.0) * 0.5 * len(light)).astype(int), 0, len(light) - 1) for x in (v, u))
    world = bpy.data.worlds.new("Studio")
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    picture, seen, ground, mix, path, output = (
        nodes.new(f"ShaderNode{name}")
        for name in ("TexEnvironment", "Background", "Background", "MixShader", "LightPath", "OutputWorld")
    )
    picture.image = _image("Studio", light[row, column])
    ground.inputs["Color"].default_value = (0.004, 0.005, 0.007, 1.0)
    links.new(picture.outputs["Color"], seen.inputs["Color"])
    seen.inputs["Strength"].default_value = EXPOSURE
    # what is seen straight, or through films alone, is the ground
    straight = nodes.new("ShaderNodeMath")
    straight.operation = "LESS_THAN"
    links.new(path.outputs["Glossy Depth"], straight.inputs[0])
    straight.inputs[1].default_value = 0.5
    links.new(straight.outputs[0], mix.inputs[0])
    links.new(seen.outputs[0], mix.inputs[1])
    links.new(ground.outputs[0], mix.inputs[2])
    links.new(mix.outputs[0], output.inputs["Surface"])
    scene.world = world


def film_material(colors: np.ndarray):
    """A material that shows the attribute `thickness` (nm) as a film."""
    import bpy

    material = bpy.data.materials.new(GROUP)
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    thickness = nodes.new("ShaderNodeAttribute")
    thickness.attribute_name = "thickness"
    film = nodes.new("ShaderNodeGroup")
    film.node_tree = film_group(colors)
    output = nodes.new("ShaderNodeOutputMaterial")
    links.new(thickness.outputs["Fac"], film.inputs["Thickness"])
    links.new(film.outputs["Shader"], output.inputs["Surface"])
    for place, node in enumerate((thickness, film, output)):
        node.location = (220 * place, 0)
    return material


def film_group(colors: np.ndarray):
    """A node group from the thickness of a film (nm) to its shader.

    A film of reflectance R, from a table of thickness and cosine, mirrors R and lets 1 - R through unbent. `Gain` above
    1 makes its reflections brighter than they are.
    """
    import bpy

    group = bpy.data.node_groups.new(GROUP, "ShaderNodeTree")
    thickness = group.interface.new_socket("Thickness", in_out="INPUT", socket_type="NodeSocketFloat")
    thickness.default_value = 400.0
    gain = group.interface.new_socket("Gain", in_out="INPUT", socket_type="NodeSocketFloat")
    gain.default_value = 1.0
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    new, link = group.nodes.new, group.links.new
    given, result = new("NodeGroupInput"), new("NodeGroupOutput")

    def math(operation: str, *inputs):
        node = new("ShaderNodeMath")
        node.operation = operation
        for socket, value in zip(node.inputs, inputs, strict=False):
            if hasattr(value, "is_output"):
                link(value, socket)
            else:
                socket.default_value = value
        return node.outputs[0]

    geometry, dot = new("ShaderNodeNewGeometry"), new("ShaderNodeVectorMath")
    dot.operation = "DOT_PRODUCT"
    link(geometry.outputs["Normal"], dot.inputs[0])
    link(geometry.outputs["Incoming"], dot.inputs[1])
    cosine = math("ABSOLUTE", dot.outputs["Value"])
    rows, columns = colors.shape[:2]
    place = new("ShaderNodeCombineXYZ")  # middles of the first and last cell are 0 and 1
    link(math("MULTIPLY_ADD", cosine, (columns - 1) / columns, 0.5 / columns), place.inputs[0])
    part = math("MINIMUM", math("DIVIDE", given.outputs["Thickness"], LARGEST), 1.0)
    link(math("MULTIPLY_ADD", part, (rows - 1) / rows, 0.5 / rows), place.inputs[1])
    table = new("ShaderNodeTexImage")
    table.image, table.interpolation, table.extension = _image("Film colours", colors), "Linear", "EXTEND"
    link(place.outputs[0], table.inputs["Vector"])
    mirror, through, both = (new(f"ShaderNode{name}") for name in ("BsdfAnisotropic", "BsdfTransparent", "AddShader"))
    mirror.inputs["Roughness"].default_value = 0.0
    scaled, rest = (new("ShaderNodeVectorMath") for _ in range(2))
    scaled.operation, rest.operation = "SCALE", "SUBTRACT"
    link(table.outputs["Color"], scaled.inputs[0])
    link(given.outputs["Gain"], scaled.inputs["Scale"])
    rest.inputs[0].default_value = (1.0, 1.0, 1.0)
    link(table.outputs["Color"], rest.inputs[1])
    link(scaled.outputs[0], mirror.inputs["Color"])
    link(rest.outputs[0], through.inputs["Color"])
    link(mirror.outputs[0], both.inputs[0])
    link(through.outputs[0], both.inputs[1])
    link(both.outputs[0], result.inputs["Shader"])
    return group


def _image(name: str, colors: np.ndarray):
    """Colours [rows, columns, 3] as an image, row 0 at the bottom."""
    import bpy

    rows, columns = colors.shape[:2]
    image = bpy.data.images.new(name, columns, rows, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    pixels = np.ones((rows, columns, 4), np.float32)
    pixels[..., :3] = np.maximum(colors.astype(np.float32), 0.0)
    image.pixels.foreach_set(pixels.ravel())
    image.pack()
    return image


def render(path: Path, frame: int, size: tuple[int, int], samples: int) -> None:
    """Render a frame of the present scene with Cycles on the CPU, before a dark ground."""
    import bpy

    scene = bpy.context.scene
    scene.frame_set(frame)
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples = "CPU", samples
    scene.cycles.transparent_max_bounces = 64
    scene.cycles.use_denoising = True
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.filepath = str(path.resolve())
    bpy.ops.render.render(write_still=True)


def main() -> None:
    """Open the cache that this file lies beside."""
    import bpy

    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    words = words if not Path(sys.argv[0]).name.startswith("blender") or "--" in sys.argv else []
    parser = argparse.ArgumentParser(description="Open the cache beside this file in Blender.")
    parser.add_argument("--points", action="store_true", help="import the particles, too")
    parser.add_argument("--frame", type=int, default=0)
    parser.add_argument("--render", type=Path, help="picture to render")
    parser.add_argument("--save", type=Path, help="file .blend to save")
    parser.add_argument("--size", default="640x360", metavar="WxH", help="pixels")
    parser.add_argument("--samples", type=int, default=32)
    options = parser.parse_args(words)
    for one in list(bpy.data.objects):
        bpy.data.objects.remove(one)
    open_cache(Path(__file__).resolve().parent, options.points)
    if options.save:
        bpy.ops.wm.save_as_mainfile(filepath=str(options.save.resolve()))
    if options.render:
        size = tuple(int(word) for word in options.size.split("x"))
        render(options.render, options.frame, size, options.samples)


if __name__ == "__main__":
    main()
