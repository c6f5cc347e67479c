//! The XML reader. It rejects a text that is not a tree file, with the line. [`Registry::check`]
//! checks the tree itself.
//!
//! [`Registry::check`]: crate::bt::Registry::check

use super::model::SubTreeDefaults;
use crate::bt::checked_node::{MAX_DEPTH, MAX_NODES};
use crate::bt::error::{TreeError, TreeErrorKind};
use crate::bt::manifest::NodeKind;
use crate::bt::script_attribute::ScriptAttribute;
use crate::bt::spec::{NodeSpec, TreeSpec};
use crate::names::join_names;
use crate::xml;
use roxmltree::Node;
use std::collections::BTreeMap;

/// Greatest size of a file, in bytes.
pub(crate) const MAX_BYTES: usize = 1 << 20;

/// Attributes that editors use for their own data; they have no effect.
const EDITORS_OWN: [&str; 4] = ["_uid", "_fullpath", "_collapsed", "_description"];

/// Reads a description. `source` names the file in messages.
///
/// The reader accepts `<root BTCPP_format="4">` with `<BehaviorTree ID="…">` elements, and nodes in
/// compact (`<Wait …/>`) or explicit form (`<Action ID="Wait" …/>`). `main_tree_to_execute` may be
/// omitted if there is only a single tree. `<TreeNodesModel>` is for editors, except for the
/// defaults of sub-trees.
/// Includes, DTDs and files above `MAX_BYTES` are rejected.
///
/// # Errors
/// [`TreeError`] with the line.
pub fn read_xml(source: &str, text: &str) -> Result<TreeSpec, TreeError> {
    let reject = |line, problem: String| TreeError {
        source: source.to_owned(),
        line,
        node: None,
        kind: Box::new(TreeErrorKind::Syntax(problem)),
    };
    if text.len() > MAX_BYTES {
        return Err(reject(None, format!("the file has {} bytes; allowed are at most {MAX_BYTES}", text.len())));
    }
    // Attributes do not count as nodes; texts and comments between elements do.
    let document = xml::parse(text, (4 * MAX_NODES) as u32)
        .map_err(|error| reject(Some(error.line()), format!("the text is not valid XML: {error}")))?;
    // The document would search the text again for each line number.
    let lines = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n').map(|(at, _)| at).collect();
    Reader { source, lines }.root(document.root_element())
}

struct Reader<'a> {
    source: &'a str,
    /// Positions of line ends, in bytes.
    lines: Vec<usize>,
}

impl Reader<'_> {
    fn root(&self, root: Node<'_, '_>) -> Result<TreeSpec, TreeError> {
        if root.tag_name().name() != "root" {
            return Err(self.reject(root, format!("the file begins with <{}>, not <root>", root.tag_name().name())));
        }
        match root.attribute("BTCPP_format") {
            Some("4") => {}
            Some(other) => return Err(self.reject(root, format!("BTCPP_format is {other:?}; supported is \"4\""))),
            None => return Err(self.reject(root, "BTCPP_format is missing; supported is \"4\"".to_owned())),
        }
        let mut trees = BTreeMap::new();
        let mut defaults = SubTreeDefaults::default();
        for element in root.children().filter(Node::is_element) {
            match element.tag_name().name() {
                "BehaviorTree" => {
                    let (id, tree) = self.tree(element)?;
                    if trees.insert(id.clone(), tree).is_some() {
                        return Err(self.reject(element, format!("there are two trees `{id}`")));
                    }
                }
                "TreeNodesModel" => defaults.read(element),
                other => {
                    let text =
                        format!("<{other}> is not allowed in <root>; allowed are <BehaviorTree> and <TreeNodesModel>");
                    return Err(self.reject(element, text));
                }
            }
        }
        trees.values_mut().for_each(|tree| defaults.apply(tree));
        let main = match (root.attribute("main_tree_to_execute"), trees.len()) {
            (Some(main), _) => main.to_owned(),
            (None, 1) => trees.keys().next().cloned().unwrap_or_default(),
            (None, 0) => return Err(self.reject(root, "there is no <BehaviorTree>".to_owned())),
            (None, _) => {
                let known = join_names(trees.keys().map(String::as_str));
                let text = format!("main_tree_to_execute is missing; the trees are {known}");
                return Err(self.reject(root, text));
            }
        };
        Ok(TreeSpec { source: self.source.to_owned(), main, trees })
    }

    fn tree(&self, element: Node<'_, '_>) -> Result<(String, NodeSpec), TreeError> {
        let Some(id) = element.attribute("ID").filter(|id| !id.is_empty()) else {
            return Err(self.reject(element, "a <BehaviorTree> needs an ID".to_owned()));
        };
        let roots: Vec<_> = element.children().filter(Node::is_element).collect();
        match roots[..] {
            [root] => Ok((id.to_owned(), self.node(root, 1)?)),
            _ => Err(self.reject(element, format!("tree `{id}` has {} root nodes; allowed is 1", roots.len()))),
        }
    }

    fn node(&self, element: Node<'_, '_>, depth: usize) -> Result<NodeSpec, TreeError> {
        if depth > MAX_DEPTH {
            return Err(self.error(element, TreeErrorKind::TooDeep { limit: MAX_DEPTH }));
        }
        let tag = element.tag_name().name();
        let kinds = [NodeKind::Action, NodeKind::Condition, NodeKind::Control, NodeKind::Decorator, NodeKind::SubTree];
        let kind = kinds.into_iter().find(|kind| kind.tag() == tag);
        let id = match (kind, element.attribute("ID")) {
            (None, None) => tag,
            (None, Some(_)) => {
                return Err(self.reject(element, format!("<{tag}> takes no ID: its kind is its tag")));
            }
            (Some(_), Some(id)) if !id.is_empty() => id,
            (Some(_), _) => return Err(self.reject(element, format!("<{tag}> needs an ID"))),
        };
        let mut node = NodeSpec { kind, line: Some(self.line(element)), ..NodeSpec::new(id) };
        for attribute in element.attributes() {
            let (name, value) = (attribute.name(), attribute.value());
            match name {
                "ID" => {}
                "name" => node.name = Some(value.to_owned()),
                "_autoremap" if kind == Some(NodeKind::SubTree) => node.autoremap = self.yes_or_no(element, value)?,
                _ if EDITORS_OWN.contains(&name) => {}
                _ if name.starts_with('_') => {
                    let Some(attribute) = ScriptAttribute::ALL.into_iter().find(|known| known.name() == name) else {
                        let allowed = join_names(ScriptAttribute::ALL.map(ScriptAttribute::name));
                        let text = format!("<{tag}> has no attribute `{name}`; allowed are its ports and {allowed}");
                        return Err(self.reject(element, text));
                    };
                    node.scripts.insert(attribute, value.to_owned());
                }
                _ => {
                    node.ports.insert(name.to_owned(), value.to_owned());
                }
            }
        }
        let mut texts = element.children().filter(Node::is_text).filter_map(|node| node.text().map(str::trim));
        if let Some(text) = texts.find(|text| !text.is_empty()) {
            return Err(self.reject(element, format!("<{tag}> contains the text {text:?}; allowed are nodes only")));
        }
        for child in element.children().filter(Node::is_element) {
            node.children.push(self.node(child, depth + 1)?);
        }
        Ok(node)
    }

    fn yes_or_no(&self, element: Node<'_, '_>, text: &str) -> Result<bool, TreeError> {
        match text {
            "true" | "1" => Ok(true),
            "false" | "0" => Ok(false),
            _ => Err(self.reject(element, format!("_autoremap is {text:?}; allowed are true and false"))),
        }
    }

    fn line(&self, element: Node<'_, '_>) -> u32 {
        // A text below `MAX_BYTES` has fewer lines than that.
        self.lines.partition_point(|end| *end < element.range().start) as u32 + 1
    }

    fn reject(&self, element: Node<'_, '_>, problem: String) -> TreeError {
        self.error(element, TreeErrorKind::Syntax(problem))
    }

    fn error(&self, element: Node<'_, '_>, problem: TreeErrorKind) -> TreeError {
        TreeError {
            source: self.source.to_owned(),
            line: Some(self.line(element)),
            node: None,
            kind: Box::new(problem),
        }
    }
}
