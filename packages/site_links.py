# SPDX-License-Identifier: GPL-3.0-or-later
"""A hook of mkdocs: links of the docs to other files of the repository, which the site does not have, become text."""

import posixpath
import re

LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)\s#]+)(#[^)\s]*)?\)")


def on_page_markdown(markdown: str, page, **_) -> str:
    """The page's text without links to files outside of docs."""
    folder = posixpath.dirname(page.file.src_uri)

    def kept(link: re.Match) -> str:
        target = posixpath.normpath(posixpath.join(folder, link[2]))
        return link[1] if target.startswith("../") else link[0]

    return LINK.sub(kept, markdown)
