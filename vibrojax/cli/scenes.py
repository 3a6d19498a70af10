"""List the scenes, or a scene's parameters, starts, friction laws, variables and settings."""

from argparse import ArgumentParser

from vibrojax.cli.completion import scenes, with_completer
from vibrojax.cli.output import Options


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    scene = parser.add_argument("scene", metavar="SCENE", nargs="?", help="one of them, in full")
    with_completer(scene, scenes)


def run(options: Options) -> None:
    """Run the command."""
    from vibrojax.analyses.catalogue import list_scenes, scene_text

    if options.scene is not None:
        print(scene_text(options.scene))
        return
    for name, row in list_scenes().iterrows():
        print(f"{name:<18}{row['what']}")
        print(f"{'':<18}starts: {row['starts'] or 'always the same'}")
