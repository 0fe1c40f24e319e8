import dev
from usarmjx.cli.setting_options import settings_page


def test_the_page_of_all_settings_is_the_generated_one():
    """After a change: `usarmjx list settings --markdown > docs/all-settings.md`."""
    assert (dev.ROOT / "docs" / "all-settings.md").read_text(encoding="utf-8") == settings_page() + "\n"
