"""Makes ``python -m cosserat_fx`` the command line."""

from cosserat_fx.cli import main

if __name__ == "__main__":
    main()
