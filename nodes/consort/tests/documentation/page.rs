//! A Markdown page: its headings, links and code blocks.

use std::path::{Path, PathBuf};

/// A fenced code block.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Block {
    /// Line of its opening fence, from 1.
    pub(crate) line: usize,
    /// First word after the fence: `yaml`, `console`; empty if there is none.
    pub(crate) language: String,
    /// Second word: the name of the file.
    pub(crate) file: Option<String>,
    pub(crate) text: String,
}

/// A page.
pub(crate) struct Page {
    pub(crate) path: PathBuf,
    /// Its lines outside of code blocks, with line numbers from 1.
    pub(crate) prose: Vec<(usize, String)>,
    pub(crate) blocks: Vec<Block>,
}

/// Returns the anchor of a heading.
pub(crate) fn anchor_of(heading: &str) -> String {
    let kept = heading.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect::<String>().to_lowercase()
}

/// Returns the folder of the repository.
pub(crate) fn repository() -> PathBuf {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    package.ancestors().nth(2).expect("the package is in nodes/").to_owned()
}

/// Collects the files of a folder with this extension.
pub(crate) fn files(folder: &Path, extension: &str, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder of the repository").flatten() {
        let path = entry.path();
        let name = entry.file_name().to_string_lossy().into_owned();
        if path.is_dir() && name != "target" && !name.starts_with('.') {
            files(&path, extension, found);
        } else if path.extension().is_some_and(|of| of == extension) {
            found.push(path);
        }
    }
}

impl Page {
    /// Opens a page by its path within the repository.
    pub(crate) fn open(path: &Path) -> Page {
        let path = repository().join(path);
        let text = std::fs::read_to_string(&path).unwrap_or_else(|problem| panic!("{}: {problem}", path.display()));
        Page::of(path, &text)
    }

    fn of(path: PathBuf, text: &str) -> Page {
        let (mut prose, mut blocks) = (vec![], vec![]);
        let mut open: Option<Block> = None;
        for (number, line) in (1..).zip(text.lines()) {
            let fence = line.trim_start().strip_prefix("```");
            match (fence, &mut open) {
                (Some(_), Some(_)) => blocks.extend(open.take()),
                (Some(info), None) => {
                    let mut words = info.split_whitespace().map(str::to_owned);
                    let language = words.next().unwrap_or_default();
                    open = Some(Block { line: number, language, file: words.next(), text: String::new() });
                }
                (None, Some(block)) => block.text.extend([line, "\n"]),
                (None, None) => prose.push((number, line.to_owned())),
            }
        }
        assert!(open.is_none(), "{}: a block is not closed", path.display());
        Page { path, prose, blocks }
    }

    /// Returns the anchors of its headings, such as `#what-it-survives`, by the rules of repository
    /// hosts.
    pub(crate) fn anchors(&self) -> Vec<String> {
        let mut anchors: Vec<String> = vec![];
        for (_, line) in &self.prose {
            let heading = line.trim_start_matches('#');
            if heading.len() == line.len() || !heading.starts_with(' ') {
                continue;
            }
            let anchor = anchor_of(heading.trim());
            let same = anchors.iter().filter(|other| **other == anchor).count();
            anchors.push(if same == 0 { anchor } else { format!("{anchor}-{same}") });
        }
        anchors
    }

    /// Returns the code in its lines, between backticks, with line numbers.
    pub(crate) fn code_spans(&self) -> impl Iterator<Item = (usize, &str)> {
        self.prose.iter().flat_map(|(number, line)| line.split('`').skip(1).step_by(2).map(move |span| (*number, span)))
    }

    /// Returns the targets of its links and images with their lines.
    pub(crate) fn links(&self) -> Vec<(usize, &str)> {
        let mut links = vec![];
        for (number, line) in &self.prose {
            let mut from = 0;
            while let Some(open) = line[from..].find("](").map(|at| from + at) {
                let Some(close) = line[open..].find(')').map(|at| open + at) else { break };
                // Text between backticks is no link.
                if line[..open].matches('`').count() % 2 == 0 {
                    links.push((*number, &line[open + 2..close]));
                }
                from = close;
            }
        }
        links
    }
}

#[test]
fn a_page_is_split_into_prose_and_blocks() {
    let text =
        "# A b, c!\n[x](y.md#z) `[a](b)` ![p](q.png)\n```yaml f.yaml\na: 1\n```\n## A-b\n## A-b\n```\n# no\n```\n";
    let page = Page::of(PathBuf::from("p.md"), text);
    assert_eq!(page.anchors(), ["a-b-c", "a-b", "a-b-1"]);
    assert_eq!(page.links(), [(2, "y.md#z"), (2, "q.png")]);
    assert_eq!(page.code_spans().collect::<Vec<_>>(), [(2, "[a](b)")]);
    let block = |line, language: &str, file: Option<&str>, text: &str| Block {
        line,
        language: language.to_owned(),
        file: file.map(str::to_owned),
        text: text.to_owned(),
    };
    assert_eq!(page.blocks, [block(3, "yaml", Some("f.yaml"), "a: 1\n"), block(8, "", None, "# no\n")]);
}
