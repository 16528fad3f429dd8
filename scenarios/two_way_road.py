"""``python -m scenarios.two_way_road`` runs this scenario headless."""

from scenarios import run_as_command

if __name__ == "__main__":
    run_as_command("two_way_road")
