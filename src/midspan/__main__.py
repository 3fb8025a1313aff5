"""`python -m midspan`: the command, where the folder of scripts is not on the path."""

from midspan.cli.main import main

if __name__ == "__main__":
    main()
