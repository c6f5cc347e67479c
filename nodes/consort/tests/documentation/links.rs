//! Links within the repository have existing targets.

use super::page::{Page, files, repository};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

#[test]
fn every_link_to_a_file_or_a_heading_has_a_target() {
    let mut found = vec![];
    files(&repository(), "md", &mut found);
    assert!(found.len() > 10, "{found:?}");
    let mut followed = 0;
    let mut wrong = vec![];
    for page in found.iter().map(|path| Page::open(path)) {
        for (line, target) in page.links() {
            if target.contains("://") || target.starts_with("mailto:") {
                continue;
            }
            followed += 1;
            let (path, anchor) = target.split_once('#').map_or((target, None), |(path, anchor)| (path, Some(anchor)));
            let at = if path.is_empty() { page.path.clone() } else { page.path.with_file_name("").join(path) };
            let reached = match anchor {
                _ if !at.exists() => false,
                Some(anchor) => Page::open(&at).anchors().iter().any(|heading| heading == anchor),
                None => true,
            };
            if !reached {
                wrong.push(format!("{}:{line}: {target} leads nowhere", page.path.display()));
            }
        }
    }
    assert!(followed > 30, "{followed} links were followed");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_page_is_reachable_from_the_readme() {
    let whole = |path: &Path| path.canonicalize().unwrap_or_else(|problem| panic!("{}: {problem}", path.display()));
    let mut come_upon = BTreeSet::new();
    let mut open = vec![whole(&repository().join("README.md"))];
    while let Some(path) = open.pop() {
        if come_upon.insert(path.clone()) {
            let page = Page::open(&path);
            let targets = page.links().into_iter().map(|(_, target)| target.split('#').next().unwrap_or_default());
            let pages = targets.filter(|target| target.ends_with(".md") && !target.contains("://"));
            open.extend(pages.map(|target| whole(&path.with_file_name(target))));
        }
    }
    let mut all = vec![];
    files(&repository().join("docs"), "md", &mut all);
    let lost: Vec<PathBuf> = all.iter().map(|path| whole(path)).filter(|path| !come_upon.contains(path)).collect();
    assert!(lost.is_empty(), "these pages are not reachable: {lost:?}");
}
