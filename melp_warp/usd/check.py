"""Checks a USD point cache for what USD itself and its validators take without a word."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from melp_warp.errors import InputError
from melp_warp.usd.check_frames import check_frame
from melp_warp.usd.check_layers import check_elsewhere, check_manifest, check_range, check_root, clips_are_ours
from melp_warp.usd.check_log import LOG, check_log, leftovers
from melp_warp.usd.check_words import few, frame_name, guarded, in_words
from melp_warp.usd.layers import open_layer, rims_of
from melp_warp.usd.schema import (
    CLIP_TEMPLATE,
    MANIFEST,
    ROOT,
    attributes_of,
    frame_path,
    layout_of,
    list_frames,
    prims_of,
    with_rows,
)

MOST_PRIMS = 100


def check_cache(directory: str | os.PathLike, at: Callable[[str], None] = lambda name: None) -> list[str]:
    """Return the problems of a cache, one line each: file, attribute, what is wrong. Empty: the cache is sound.

    Read are the root, the manifest, every frame and run.jsonl, where their checksums are. The root is opened as a stage
    to see that the values arrive through the clips, and the validators of `pxr.UsdValidation` run over it and the first
    frame: only if they take nothing from elsewhere. The files may be anybody's, but USD itself may hang on what it did
    not write; `apart.check_cache` outlives that.

    Args:
        directory: folder with film.usda.
        at: told the name of each file before it is opened.
    """
    directory = Path(directory)
    problems = leftovers(directory)
    on_disk = list_frames(directory)
    problems += guarded(LOG, check_log, directory, on_disk, at)
    at(ROOT)
    try:
        root = open_layer(directory / ROOT)
        prims = prims_of(root)
        layout = layout_of(root, prims)
    except InputError as error:
        return [*problems, f"{ROOT}: {error}"]
    except Exception as error:  # a name that Python cannot hold
        return [*problems, f"{ROOT}: cannot be checked: {in_words(error)}"]
    if len(prims) > MOST_PRIMS:
        return [*problems, f"{ROOT}: has {len(prims)} prims, more than {MOST_PRIMS}"]
    of_root = guarded(ROOT, check_root, root, prims)
    try:
        rims = len(rims_of(root))
    except Exception as error:
        of_root.append(f"{ROOT}: cannot be checked: {in_words(error)}")
        rims = 0
    elsewhere = guarded(ROOT, check_elsewhere, ROOT, root)
    at(MANIFEST)
    of_manifest, readable = check_manifest(directory, prims, layout)
    missing, fit = check_range(root, on_disk)
    problems += of_root + elsewhere + of_manifest + missing
    whole = fit and readable and clips_are_ours(root, prims) and not elsewhere
    for frame in on_disk:
        at(frame_name(frame))
        try:
            layer = open_layer(frame_path(directory, frame))
        except InputError as error:
            problems.append(f"{frame_name(frame)}: {error}")
            whole = False  # USD cannot open a stage over a damaged frame
            continue
        found = guarded(frame_name(frame), check_elsewhere, frame_name(frame), layer)
        whole = whole and not found
        problems += found + guarded(frame_name(frame), check_frame, layer, frame, root, prims, layout, rims)
    if on_disk and whole:
        at(ROOT)
        problems += guarded(ROOT, _check_stages, directory, on_disk[0], root, prims)
    return problems


def _check_stages(directory: Path, first: int, root, prims: list[str]) -> list[str]:
    """Values arrive through the clips, and USD's own validators report nothing."""
    from pxr import Tf, Usd, UsdUtils

    problems = []
    diagnostics = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        stage = Usd.Stage.Open(str(directory / ROOT))
        stage.Reload()
        problems += _check_through_clips(stage, root, prims)
        problems += _validate(ROOT, stage)
        stage = Usd.Stage.Open(str(frame_path(directory, first)))
        stage.Reload()
        problems += _validate(frame_name(first), stage)
    except Tf.ErrorException as error:
        problems.append(f"{ROOT}: USD cannot open the cache: {' '.join(str(error).split())}")
    for diagnostic in diagnostics.TakeUncoalescedDiagnostics():
        # USD's list of dependencies knows no templates and takes this one for a file.
        if CLIP_TEMPLATE not in diagnostic.commentary:
            problems.append(f"{ROOT}: USD warns: {' '.join(diagnostic.commentary.split())}")
    return few(problems)


def _check_through_clips(stage, root, prims: list[str]) -> list[str]:
    from pxr import Usd

    wanted = [float(time) for time in range(int(root.startTimeCode), int(root.endTimeCode) + 1)]
    problems = []
    for prim in prims:
        uneven, elsewhere = [], []
        for name in (attribute.name for attribute in with_rows(attributes_of(prim, layout_of(root, [prim])))):
            found = stage.GetAttributeAtPath(f"/World/{prim}.{name}")
            if not found or found.GetTimeSamples() != wanted:
                uneven.append(name)
            elif found.GetResolveInfo(wanted[0]).GetSource() != Usd.ResolveInfoSourceValueClips:
                elsewhere.append(name)
        for names, fault in ((uneven, "not one sample for each frame"), (elsewhere, "values from outside the frames")):
            if names:
                problems.append(f"{ROOT}: /World/{prim}: {', '.join(names)}: the stage has {fault}")
    return problems


def _validate(name: str, stage) -> list[str]:
    from pxr import UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    return [f"{name}: UsdValidation: {' '.join(error.GetErrorAsString().split())}" for error in errors]
