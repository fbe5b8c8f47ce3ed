"""The `locsim` command, in this process."""

import shutil
import sys
from pathlib import Path

from locsim._locsim import main as run


def program() -> str:
    """The path by which batch engines call the command again."""
    called = Path(sys.argv[0])
    if called.stem == "locsim" and called.is_file():
        return str(called.absolute())
    beside = shutil.which("locsim", path=str(Path(sys.executable).parent))
    return beside or "locsim"


def main() -> int:
    """Runs the command line and returns the exit code."""
    return run([program(), *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
