"""axe-core finds nothing to complain about, in any state of the page, light and dark, wide and on a phone."""

from __future__ import annotations

from typing import Any

import pytest

from tests.support.browser import ROOT, Opener
from tests.web.fake_service import Fake
from tests.web.states import STATES
from tests.web.test_access import PHONE

pytestmark = pytest.mark.slow

AXE = ROOT / "web" / "node_modules" / "axe-core" / "axe.min.js"
REFUSED = "Failed to load resource"
RUN = """async () => {
    const {violations, passes} = await axe.run(document, {resultTypes: ['violations']});
    return {passed: passes.length, wrong: violations.map((one) =>
        `${one.id} (${one.impact}): ${one.nodes.map((node) => node.html.slice(0, 90)).join(' | ')}`)};
}"""

SCREENS: dict[str, dict[str, Any]] = {
    "wide": {"color_scheme": "light"},
    "wide, dark": {"color_scheme": "dark"},
    "phone": {**PHONE, "color_scheme": "light"},
}


@pytest.mark.parametrize("screen", SCREENS)
def test_axe_finds_no_violation(screen: str, fake: Fake, open_page: Opener) -> None:
    if not AXE.is_file():
        pytest.skip("axe-core is not installed: make web")
    page = open_page(fake.address, expected=(REFUSED,), **SCREENS[screen])
    wrong, seen = [], []
    for states in STATES:
        for name in states(page, fake):
            if not page.evaluate("'axe' in window"):
                page.evaluate(AXE.read_text("utf-8"))  # by the debugger: the content security policy holds for the page
            found = page.evaluate(RUN)
            assert found["passed"] > 10, f"{name}: axe looked at nothing"
            wrong += [f"{name}: {text}" for text in found["wrong"]]
            seen.append(name)
    assert len(seen) == 14
    assert not wrong, "\n".join(wrong)
