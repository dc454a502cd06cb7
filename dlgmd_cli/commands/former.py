"""What stands now for the commands and options of earlier versions."""

# Former commands -> their replacement.
COMMANDS = {
    "kernels": "dlgmd sets show NAME --plot FILE",
    "reproduce": "dlgmd lab paper",
    "bench": "dlgmd lab bench",
}
_IN_PYTHON = "use {name}= in Python"
# A command, or "" for every other command -> answer -> the former options with this answer.
_ANSWERS = {
    "batch": {"use --size": "--scale"},
    "bench": {"videos are read by the default decoder": "--decoder"},
    "compare": {
        "use --size": "--scale",
        "use --variant no-ffi-gd:ffi_gd=false": "--no-ffi-gd",
        "use --variant NAME:formulation=NAME": "--formulation",
        "use 'dlgmd plot', which has it": "--mark --span --until --width",
        _IN_PYTHON: "--bit-depth --crop --decoder --mask --repeats --topic",
    },
    "evaluate": {"use --brake 4.6": "--agile", "use --tilt and --jerk": "--stabilised"},
    "live": {"use --size": "--scale", "duplicate frames are skipped": "--repeats"},
    "paper": {"a report is full, or --quick": "--seeds --size", "figures are PDF, too": "--dpi"},
    "plot": {
        "use the ending of --out, such as mp.pdf": "--dpi --format",
        "use 'dlgmd compare', which has it": "--false-positive-frame",
        "a stored result keeps its alarms": "--alarm",
        "a stored result is drawn as it was processed": "--bit-depth --camera-tilt --crop "
        "--decoder --end --fov --fps --input-fps --mask --repeats --scale --size --start --topic",
    },
    "sweep": {"use --cube-size": "--object-size", "use --size": "--scale"},
    "synth": {
        "use 'dlgmd lab fly', which has it": "--agile --camera-tilt --count --jobs --manner --png",
        "use 'dlgmd lab fly', whose drones are stabilised": "--stabilised",
        "use 'dlgmd lab fly --with flight'": "--avoid",
        "images have noise alone (--noise)": "--exposure --gamma --rolling-shutter --shot-noise "
        "--vignette",
        "use --out with a folder for each clip": "--name",
        "see 'dlgmd synth --help'": "--list",
        "the video shows all frames": "--dpi --sheet",
    },
    "": {
        "use --param formulation=NAME": "--formulation",
        "use --param alarm=RULE": "--alarm",
        "use environment variables such as DLGMD_RUN_FOV=90": "--settings",
        "use Optuna with dlgmd_cli.evaluate": "--search --trials",
        "use --format none": "--no-plots",
        "use --format pdf, or dpi= in Python": "--dpi",
        "use --out DIR": "--csv",
        "use hashed= in Python": "--hash --no-hash",
        "use collisions= in Python": "--labels",
        "an alarm counts by its onset, see 'dlgmd evaluate --help'": "--horizon",
        "the film is as wide as the frames for which the model is made": "--film-width",
        _IN_PYTHON: "--collision-frame --collisions --exclude --frames --name --width",
        "use {name}: below options: in a --config file, or {name}= in Python": "--bit-depth "
        "--camera-tilt --crop --decoder --end --fov --fps --input-fps --mask --normalise --repeats "
        "--scale --size --start --topic",
    },
}
# A command, or "" -> its former options -> the answer.
OPTIONS = {
    command: {
        option: answer.format(name=option.removeprefix("--").replace("-", "_"))
        for answer, options in answers.items()
        for option in options.split()
    }
    for command, answers in _ANSWERS.items()
}


def answer(command: str, option: str) -> str | None:
    """What stands for an option that a command does not have; None if no version had the option."""
    return OPTIONS.get(command, {}).get(option, OPTIONS[""].get(option))
