"""List the code blocks of the documents that no test runs: python -m tests.docs."""

from collections import Counter

from tests.docs.pages import PAGES, blocks


def main() -> None:
    found = [block for page in PAGES for block in blocks(page)]
    for block in found:
        if block.reason is not None:
            print(f"{block} ({block.language}): {block.reason}")
    kinds = Counter(block.kind for block in found)
    print(", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items())))


if __name__ == "__main__":
    main()
