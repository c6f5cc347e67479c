//! Tests that pages name exist, and the security page names tests for each role of a certificate.

use super::page::{Page, files, repository};
use consort_protocol::trust::NodeRole;
use std::path::{Path, PathBuf};

/// Folders and files of which a page leaves out the name.
const UNNAMED: [&str; 3] = ["src", "tests", "mod"];

/// Page whose short references, as `closed::a_test`, are checked, too. In other pages they may be paths of Rust.
const SECURITY: &str = "docs/security.md";

/// A test of the sources.
struct SourceTest {
    /// Folders and modules that contain it, from the outermost one.
    modules: Vec<String>,
    name: String,
}

/// Reference of a page to tests: `virtual_fleets closed::the_key_of_a_robot_*`. The first word, which is a package or a
/// program of tests, may be left out.
#[derive(Debug, PartialEq, Eq)]
struct TestReference<'a> {
    suite: Option<&'a str>,
    modules: Vec<&'a str>,
    /// A name, or the first part of names and `*`.
    name: &'a str,
}

fn is_name(text: &str) -> bool {
    !text.is_empty() && text.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
}

impl<'a> TestReference<'a> {
    /// Returns the reference in a code span, or `None` if the span contains something else.
    fn parse(span: &'a str) -> Option<TestReference<'a>> {
        let (suite, path) = span.split_once(' ').map_or((None, span), |(suite, path)| (Some(suite), path));
        let (modules, name) = path.rsplit_once("::")?;
        let modules: Vec<&str> = modules.split("::").collect();
        let is_reference = suite.is_none_or(is_name)
            && modules.iter().all(|module| is_name(module))
            && (name == "*" || is_name(name.strip_suffix('*').unwrap_or(name)));
        is_reference.then_some(TestReference { suite, modules, name })
    }

    fn matches(&self, test: &SourceTest) -> bool {
        let is_named = match self.name.strip_suffix('*') {
            Some(first) => test.name.starts_with(first),
            None => test.name == self.name,
        };
        let Some(outer) = test.modules.len().checked_sub(self.modules.len()) else { return false };
        let (outer, inner) = test.modules.split_at(outer);
        is_named && inner == self.modules && self.suite.is_none_or(|suite| outer.iter().any(|module| module == suite))
    }
}

/// Returns the tests of a source file, by its path within the repository.
fn tests_of(path: &Path, text: &str) -> Vec<SourceTest> {
    let path = path.with_extension("");
    let modules = path.iter().map(|part| part.to_string_lossy().into_owned());
    let modules: Vec<String> = modules.filter(|module| !UNNAMED.contains(&module.as_str())).collect();
    let (mut tests, mut is_test) = (vec![], false);
    for line in text.lines().map(str::trim_start) {
        is_test |= line.starts_with("#[test]") || line.starts_with("#[tokio::test");
        let function = line.strip_prefix("async ").unwrap_or(line).strip_prefix("fn ");
        if let Some((name, _)) = function.and_then(|function| function.split_once('(')).filter(|_| is_test) {
            tests.push(SourceTest { modules: modules.clone(), name: name.to_owned() });
            is_test = false;
        }
    }
    tests
}

fn all_tests() -> Vec<SourceTest> {
    let (root, mut sources) = (repository(), vec![]);
    files(&root, "rs", &mut sources);
    let of_file = |path: &PathBuf| {
        let text = std::fs::read_to_string(path).expect("a file of the repository");
        tests_of(path.strip_prefix(&root).expect("it is below the root"), &text)
    };
    sources.iter().flat_map(of_file).collect()
}

#[test]
fn every_test_that_a_page_names_exists() {
    let (tests, mut pages) = (all_tests(), vec![]);
    assert!(tests.len() > 1000, "{} tests were found", tests.len());
    files(&repository(), "md", &mut pages);
    let (mut named, mut missing) = (0, vec![]);
    for page in pages.iter().map(|path| Page::open(path)) {
        let is_security = page.path.ends_with(SECURITY);
        for (line, span) in page.code_spans() {
            let reference = TestReference::parse(span).filter(|reference| is_security || reference.suite.is_some());
            let Some(reference) = reference else { continue };
            named += 1;
            if !tests.iter().any(|test| reference.matches(test)) {
                missing.push(format!("{}:{line}: there is no test `{span}`", page.path.display()));
            }
        }
    }
    assert!(named > 30, "{named} tests are named");
    assert!(missing.is_empty(), "name them in the page as in the sources:\n{}", missing.join("\n"));
}

#[test]
fn the_security_page_names_tests_for_each_role_of_a_certificate() {
    let page = Page::open(Path::new(SECURITY));
    let roles = NodeRole::ALL.iter().map(|role| format!("role `{role}`"));
    for key in roles.chain(["no role".to_owned(), "person".to_owned()]) {
        let row = page.prose.iter().find(|(_, line)| line.starts_with(&format!("| {key} |")));
        let (line, row) = row.unwrap_or_else(|| panic!("{SECURITY}: there is no row for {key}"));
        let spans = row.split('`').skip(1).step_by(2);
        let named = spans.filter_map(TestReference::parse).count();
        assert!(named > 0, "{SECURITY}:{line}: the row of {key} names no test");
    }
}

#[test]
fn references_to_tests_are_told_from_other_code() {
    let reference = |suite, modules: &[&'static str], name| TestReference { suite, modules: modules.to_vec(), name };
    let expected = reference(Some("protocol"), &["access", "rights"], "*");
    assert_eq!(TestReference::parse("protocol access::rights::*"), Some(expected));
    assert_eq!(TestReference::parse("closed::a_node_*"), Some(reference(None, &["closed"], "a_node_*")));
    for other in ["consort cert", "wire/raft/**", "cargo test a::b", "std::Vec", "a::*b", "::a", "A b::c"] {
        assert_eq!(TestReference::parse(other), None, "{other}");
    }
    let text = "#[test]\nfn a_node_starts() {\n}\nfn a_node_helps() {}\n#[tokio::test(x)]\nasync fn a_node_ends() {";
    let tests = tests_of(Path::new("actors/bus/tests/trust/closed.rs"), text);
    let named: Vec<&str> = tests.iter().map(|test| test.name.as_str()).collect();
    assert_eq!(named, ["a_node_starts", "a_node_ends"]);
    let is_found = |span| tests.iter().any(|test| TestReference::parse(span).expect("a reference").matches(test));
    for found in ["trust closed::a_node_ends", "closed::a_node_e*", "bus trust::closed::*", "actors closed::*"] {
        assert!(is_found(found), "{found}");
    }
    for lost in ["trust closed::a_node_helps", "raft closed::*", "trust open::*", "a::actors::bus::trust::closed::*"] {
        assert!(!is_found(lost), "{lost}");
    }
}
