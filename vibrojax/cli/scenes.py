"""List the scenes, or a scene's parameters, starts, friction laws, variables and settings."""

from argparse import ArgumentParser

from vibrojax.cli._command import Options


def arguments(parser: ArgumentParser) -> None:
    """Add the command's arguments to `parser`."""
    parser.add_argument("scene", metavar="SCENE", nargs="?", help="one of them, in full")


def run(options: Options) -> None:
    """Run the command."""
    from vibrojax.reference import list_scenes, scene_text

    if options.scene is not None:
        print(scene_text(options.scene))
        return
    for name, row in list_scenes().iterrows():
        print(f"{name:<18}{row['what']}")
        print(f"{'':<18}starts: {row['starts'] or 'always the same'}")
