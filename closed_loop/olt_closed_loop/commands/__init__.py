"""`olt closed-loop`: drive scenes and score the drives; each module imports its work only when called."""

import typer

from olt_closed_loop.commands.run import run
from olt_closed_loop.commands.scenes import convert_scene, faults, gate
from olt_closed_loop.commands.scores import compare, score_rollout, show
from olt_closed_loop.commands.serve import serve, serve_vehicle
from olt_closed_loop.commands.suite import app as suite_app

app = typer.Typer(no_args_is_help=True, help="Drive policies through scenes and score them.")
app.add_typer(suite_app, name="suite")
for command in (run, serve, serve_vehicle, show, compare, gate):
    app.command()(command)
app.command(name="scene")(convert_scene)
for command in (score_rollout, faults):
    app.command()(command)
