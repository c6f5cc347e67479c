//! Cycles among the modules of a crate, found in its source text.
//!
//! A module depends on each module that defines a name which it imports or writes as a path.
//! Imports through a facade (`pub use`) count for the module that defines the name. The children
//! of each module are compared with each other, including everything below them. Code for tests
//! does not count, and neither does a module's own `mod.rs` as a neighbour of its children.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// Module: its names from the root of the crate.
type Module = Vec<String>;

/// Cycle among the children of a module.
#[derive(Debug)]
pub(crate) struct Cycle {
    /// The module: `crate`, `crate::robot`.
    pub(crate) parent: String,
    /// Children that depend on each other.
    pub(crate) children: BTreeSet<String>,
    /// Paths by which they do: `a -> b (crate::b::Name)`.
    pub(crate) uses: BTreeSet<String>,
}

/// Finds the cycles of the crate in a folder, at every depth.
pub(crate) fn cycles(package: &Path) -> Vec<Cycle> {
    let mut sources = Sources::default();
    for root in ["lib.rs", "main.rs"].map(|name| package.join("src").join(name)) {
        if root.exists() {
            sources.load(vec![], &root, &package.join("src"));
            break;
        }
    }
    let uses = sources.dependencies();
    let parents: BTreeSet<&[String]> =
        sources.modules.keys().filter_map(|module| Some(module.split_last()?.1)).collect();
    parents.into_iter().flat_map(|parent| cycles_below(parent, &uses)).collect()
}

/// Dependency between two modules, with the path that is written.
type Dependency = (Module, Module, String);

fn cycles_below(parent: &[String], uses: &[Dependency]) -> Vec<Cycle> {
    let depth = parent.len();
    let child = |module: &Module| (module.starts_with(parent)).then(|| module.get(depth).cloned()).flatten();
    let mut edges: BTreeMap<(String, String), &str> = BTreeMap::new();
    for (from, to, path) in uses {
        if let (Some(from), Some(to)) = (child(from), child(to))
            && from != to
        {
            edges.entry((from, to)).or_insert(path);
        }
    }
    let mut reach: BTreeSet<(String, String)> = edges.keys().cloned().collect();
    let names: BTreeSet<String> = reach.iter().map(|(from, _)| from.clone()).collect();
    for via in &names {
        let into: Vec<String> = reach.iter().filter(|(_, to)| to == via).map(|(from, _)| from.clone()).collect();
        let out: Vec<String> = reach.iter().filter(|(from, _)| from == via).map(|(_, to)| to.clone()).collect();
        reach.extend(into.iter().flat_map(|from| out.iter().map(move |to| (from.clone(), to.clone()))));
    }
    let mutual = |from: &String, to: &String| {
        reach.contains(&(from.clone(), to.clone())) && reach.contains(&(to.clone(), from.clone()))
    };
    let groups: BTreeSet<BTreeSet<String>> = names
        .iter()
        .map(|name| names.iter().filter(|other| mutual(name, other)).cloned().collect::<BTreeSet<String>>())
        .filter(|group| !group.is_empty())
        .collect();
    let parent = [&["crate".to_owned()], parent].concat().join("::");
    let cycle = |children: BTreeSet<String>| {
        let inside = edges.iter().filter(|((from, to), _)| children.contains(from) && children.contains(to));
        let uses = inside.map(|((from, to), path)| format!("{from} -> {to} ({path})")).collect();
        Cycle { parent: parent.clone(), children, uses }
    };
    groups.into_iter().map(cycle).collect()
}

/// Modules of a crate with their code.
#[derive(Default)]
struct Sources {
    modules: BTreeMap<Module, Vec<String>>,
}

/// Names that a module imports: paths from the root of the crate, by name; and globs.
#[derive(Default)]
struct Imports {
    names: BTreeMap<String, Vec<String>>,
    globs: Vec<Vec<String>>,
}

impl Sources {
    /// Loads the module in a file, and the modules below it, which are in `folder`.
    fn load(&mut self, module: Module, file: &Path, folder: &Path) {
        let text = fs::read_to_string(file).unwrap_or_else(|problem| panic!("{}: {problem}", file.display()));
        self.add(module, without_tests(&tokens(&text)), folder);
    }

    fn add(&mut self, module: Module, code: Vec<String>, folder: &Path) {
        let mut own = Vec::new();
        let mut at = 0;
        while at < code.len() {
            let (name, next) = (code.get(at + 1), code.get(at + 2).map(String::as_str));
            let (Some(name), "mod", Some("{" | ";")) = (name, code[at].as_str(), next) else {
                own.push(code[at].clone());
                at += 1;
                continue;
            };
            let below = [&module[..], std::slice::from_ref(name)].concat();
            let end = item_end(&code, at);
            let inner = folder.join(name);
            if next == Some("{") {
                self.add(below, code[at + 3..end - 1].to_vec(), &inner);
            } else {
                let files = [folder.join(format!("{name}.rs")), inner.join("mod.rs")];
                if let Some(file) = files.iter().find(|file| file.exists()) {
                    self.load(below, file, &inner);
                }
            }
            at = end;
        }
        self.modules.insert(module, own);
    }

    /// Returns the dependencies of all modules.
    fn dependencies(&self) -> Vec<Dependency> {
        let parsed: BTreeMap<&Module, (Imports, Vec<Vec<String>>)> =
            self.modules.iter().map(|(module, code)| (module, self.paths(module, code))).collect();
        let imports: BTreeMap<&Module, &Imports> = parsed.iter().map(|(module, (names, _))| (*module, names)).collect();
        let mut found = Vec::new();
        for (module, (_, paths)) in &parsed {
            for path in paths {
                let target = self.definition(path.clone(), &imports, 0);
                if target != **module {
                    found.push(((*module).clone(), target, format!("crate::{}", path.join("::"))));
                }
            }
        }
        found
    }

    /// Returns the module that defines the name at the end of a path from the root.
    fn definition(&self, path: Vec<String>, imports: &BTreeMap<&Module, &Imports>, depth: usize) -> Module {
        let mut module = Module::new();
        for (index, name) in path.iter().enumerate() {
            let below = [&module[..], std::slice::from_ref(name)].concat();
            if self.modules.contains_key(&below) {
                module = below;
                continue;
            }
            let Some(imported) = imports.get(&module).filter(|_| depth < 12) else { return module };
            if let Some(known) = imported.names.get(name).filter(|known| known[..] != path[..=index]) {
                return self.definition([known, &path[index + 1..]].concat(), imports, depth + 1);
            }
            let is_definition = |pair: &[String]| {
                pair[1] == *name
                    && ["struct", "enum", "fn", "trait", "type", "const", "static"].contains(&pair[0].as_str())
            };
            let defines =
                |glob: &&Vec<String>| self.modules.get(*glob).is_some_and(|code| code.windows(2).any(is_definition));
            return imported.globs.iter().find(defines).cloned().unwrap_or(module);
        }
        module
    }

    /// Returns the imports of a module, and all its paths from the root of the crate.
    fn paths(&self, module: &Module, code: &[String]) -> (Imports, Vec<Vec<String>>) {
        let mut imports = Imports::default();
        let mut found = Vec::new();
        let mut at = 0;
        while at < code.len() {
            if code[at] == "use" && code.get(at + 1).is_some_and(|next| next != "<") {
                let end = at + code[at..].iter().position(|token| token == ";").unwrap_or(0);
                for (path, name) in use_tree(&code[at + 1..end], &[]) {
                    let Some(path) = self.path_in_crate(module, &path) else { continue };
                    match path.split_last() {
                        Some((last, glob)) if last == "*" => {
                            imports.globs.push(glob.to_vec());
                            found.push(glob.to_vec());
                        }
                        _ => {
                            found.push(path.clone());
                            imports.names.insert(name, path);
                        }
                    }
                }
                at = end + 1;
                continue;
            }
            let mut path = vec![code[at].clone()];
            while code.get(at + 1).is_some_and(|next| next == "::")
                && code.get(at + 2).is_some_and(|next| is_identifier(next))
            {
                path.push(code[at + 2].clone());
                at += 2;
            }
            if path.len() > 1 {
                found.extend(self.path_in_crate(module, &path));
            }
            at += 1;
        }
        (imports, found)
    }

    /// Returns a path of a module from the root of the crate; `None` for a path to another crate or
    /// to a local name.
    fn path_in_crate(&self, module: &Module, path: &[String]) -> Option<Vec<String>> {
        let above = path.iter().take_while(|name| *name == "super").count();
        match path.first()?.as_str() {
            "crate" => Some(path[1..].to_vec()),
            "self" => Some([module, &path[1..]].concat()),
            "super" => Some([&module[..module.len().checked_sub(above)?], &path[above..]].concat()),
            name => {
                let below = [&module[..], &[name.to_owned()]].concat();
                self.modules.contains_key(&below).then(|| [module, path].concat())
            }
        }
    }
}

/// Returns the paths of a `use` with the names that they introduce.
fn use_tree(tokens: &[String], before: &[String]) -> Vec<(Vec<String>, String)> {
    let mut path = before.to_vec();
    let mut at = 0;
    while at < tokens.len() {
        match tokens[at].as_str() {
            "::" => {}
            "{" => {
                let (mut depth, mut start, mut found) = (0, at + 1, Vec::new());
                for (index, token) in tokens.iter().enumerate().skip(at) {
                    depth += i32::from(token == "{") - i32::from(token == "}");
                    if depth == 1 && token == "," || depth == 0 {
                        found.extend(use_tree(&tokens[start..index], &path));
                        start = index + 1;
                    }
                    if depth == 0 {
                        break;
                    }
                }
                return found;
            }
            "as" => return vec![(path, tokens[at + 1].clone())],
            "self" if !path.is_empty() => {}
            name => path.push(name.to_owned()),
        }
        at += 1;
    }
    match path.last().cloned() {
        Some(name) if path.len() > before.len() || tokens.iter().any(|token| token == "self") => vec![(path, name)],
        _ => vec![],
    }
}

/// Drops the items that are compiled only for tests.
fn without_tests(tokens: &[String]) -> Vec<String> {
    let starts =
        |at: usize, words: &[&str]| tokens[at..].iter().zip(words).filter(|(a, b)| a == b).count() == words.len();
    let mut kept = Vec::new();
    let mut at = 0;
    while at < tokens.len() {
        let only_in_tests = starts(at, &["#", "[", "cfg", "(", "test"])
            || starts(at, &["#", "[", "cfg", "(", "any", "(", "test"])
            || starts(at, &["#", "[", "cfg", "(", "all", "(", "test"]);
        if only_in_tests {
            let attribute = tokens[at..].iter().position(|token| token == "]").unwrap_or(0);
            at = item_end(tokens, at + attribute + 1);
        } else {
            kept.push(tokens[at].clone());
            at += 1;
        }
    }
    kept
}

/// Returns the index after the item that starts at `at`: after its block, or its semicolon.
fn item_end(tokens: &[String], at: usize) -> usize {
    let mut depth = 0;
    for (index, token) in tokens.iter().enumerate().skip(at) {
        depth += i32::from(token == "{") - i32::from(token == "}");
        if depth == 0 && (token == "}" || token == ";") {
            return index + 1;
        }
    }
    tokens.len()
}

fn is_identifier(token: &str) -> bool {
    token.chars().all(|c| c.is_alphanumeric() || c == '_')
}

/// Splits source text into identifiers, `::` and single characters, without comments and literals.
fn tokens(text: &str) -> Vec<String> {
    let text: Vec<char> = text.chars().collect();
    let at_is = |at: usize, word: &str| word.chars().enumerate().all(|(i, c)| text.get(at + i) == Some(&c));
    let find = |from: usize, word: &str| (from..text.len()).find(|at| at_is(*at, word)).unwrap_or(text.len());
    let mut found: Vec<String> = Vec::new();
    let mut at = 0;
    while at < text.len() {
        let c = text[at];
        if at_is(at, "//") {
            at = find(at, "\n");
        } else if at_is(at, "/*") {
            at = find(at, "*/") + 2;
        } else if c == '"' {
            at += 1;
            while at < text.len() && text[at] != '"' {
                at += if text[at] == '\\' { 2 } else { 1 };
            }
            at += 1;
        } else if c == '\'' {
            // A character, or a lifetime.
            let quoted = text.get(at + 1) == Some(&'\\') || text.get(at + 2) == Some(&'\'');
            at = if quoted { find(at + 3 - usize::from(text[at + 1] != '\\'), "'") + 1 } else { at + 1 };
        } else if c.is_alphanumeric() || c == '_' {
            let end = (at..text.len()).find(|i| !text[*i].is_alphanumeric() && text[*i] != '_').unwrap_or(text.len());
            let word: String = text[at..end].iter().collect();
            let hashes = text[end..].iter().take_while(|c| **c == '#').count();
            if ["r", "br"].contains(&word.as_str()) && text.get(end + hashes) == Some(&'"') {
                let close = format!("\"{}", "#".repeat(hashes));
                at = find(end + hashes + 1, &close) + close.len();
            } else {
                found.push(word);
                at = end;
            }
        } else if at_is(at, "::") {
            found.push("::".to_owned());
            at += 2;
        } else {
            found.extend((!c.is_whitespace()).then(|| c.to_string()));
            at += 1;
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sources(modules: &[(&str, &str)]) -> Sources {
        let mut sources = Sources::default();
        for (path, code) in modules {
            let module = path.split("::").filter(|name| !name.is_empty()).map(str::to_owned).collect();
            sources.modules.insert(module, without_tests(&tokens(code)));
        }
        sources
    }

    fn found(modules: &[(&str, &str)]) -> Vec<Vec<String>> {
        let uses = sources(modules).dependencies();
        cycles_below(&[], &uses).into_iter().map(|cycle| cycle.uses.into_iter().collect()).collect()
    }

    #[test]
    fn imports_paths_and_facades_are_followed() {
        let cycle = [
            ("", "pub use a::A; mod a; mod b; mod c;"),
            ("a", "use crate::b::{self, deep::{C as D}}; struct A;"),
            ("b", "struct B; fn b() { crate::c::c() }"),
            ("b::deep", "struct C;"),
            ("c", "fn c() { let _ = crate::A; }"),
        ];
        assert_eq!(found(&cycle), [["a -> b (crate::b)", "b -> c (crate::c::c)", "c -> a (crate::A)"]]);
    }

    #[test]
    fn tests_comments_and_texts_are_no_dependencies() {
        let none = [
            ("", "mod a; mod b;"),
            ("a", "use crate::b::B; struct A;"),
            (
                "b",
                "// crate::a::A\nstruct B<'a>(&'a str, char); fn b() -> B<'static> { B(\"crate::a::A\", '\"') }\n\
                   #[cfg(test)] mod tests { use crate::a::A; }",
            ),
        ];
        assert_eq!(found(&none), Vec::<Vec<String>>::new());
    }
}
