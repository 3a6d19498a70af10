"""List the scenes, or a scene's parameters, initial conditions, friction laws, variables and settings."""

from argparse import ArgumentParser

from vibrojax.cli.completion import add_argument, scenes
from vibrojax.cli.output import Options


def arguments(parser: ArgumentParser) -> None:
    add_argument(parser, "scene", completer=scenes, metavar="SCENE", nargs="?", help="one of them, in full")


def run(options: Options) -> None:
    from vibrojax.analyses.catalogue import list_scenes, scene_text

    if options.scene is not None:
        print(scene_text(options.scene))
        return
    for name, row in list_scenes().iterrows():
        print(f"{name:<18}{row['what']}")
        print(f"{'':<18}starts: {row['starts'] or 'always the same'}")
