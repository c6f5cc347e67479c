//! The XML writer. It adds the model of the registered leaves, so that editors have their ports.

use crate::bt::manifest::{NodeKind, NodeManifest, PortDirection, PortPresence, PortSpec};
use crate::bt::registry::Registry;
use crate::bt::spec::{NodeSpec, TreeSpec};
use std::fmt::Write;

/// Writes a description in the form that [`read_xml`](super::read_xml) reads, followed by the model
/// of the registry's leaves.
pub fn write_xml<C>(spec: &TreeSpec, registry: &Registry<C>) -> String {
    let mut xml = String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n");
    line(&mut xml, 0, &format!("<root BTCPP_format=\"4\"{}>", attribute("main_tree_to_execute", &spec.main)));
    for (id, root) in &spec.trees {
        line(&mut xml, 1, &format!("<BehaviorTree{}>", attribute("ID", id)));
        node(&mut xml, 2, root);
        line(&mut xml, 1, "</BehaviorTree>");
    }
    line(&mut xml, 1, "<TreeNodesModel>");
    for manifest in registry.manifests() {
        model(&mut xml, manifest);
    }
    line(&mut xml, 1, "</TreeNodesModel>");
    line(&mut xml, 0, "</root>");
    xml
}

fn node(xml: &mut String, depth: usize, node: &NodeSpec) {
    let (tag, id) = match node.kind {
        Some(kind) => (kind.tag(), attribute("ID", &node.id)),
        None => (node.id.as_str(), String::new()),
    };
    let mut open = format!("<{tag}{id}");
    if let Some(name) = &node.name {
        open += &attribute("name", name);
    }
    for (port, binding) in &node.ports {
        open += &attribute(port, binding);
    }
    for (script_attribute, script) in &node.scripts {
        open += &attribute(script_attribute.name(), script);
    }
    if node.autoremap {
        open += &attribute("_autoremap", "true");
    }
    if node.children.is_empty() {
        return line(xml, depth, &format!("{open}/>"));
    }
    line(xml, depth, &format!("{open}>"));
    for child in &node.children {
        self::node(xml, depth + 1, child);
    }
    line(xml, depth, &format!("</{tag}>"));
}

fn model(xml: &mut String, manifest: &NodeManifest) {
    let tag = if manifest.kind == NodeKind::Condition { "Condition" } else { "Action" };
    let open = format!("<{tag}{}", attribute("ID", &manifest.id));
    if manifest.ports.is_empty() {
        return line(xml, 2, &format!("{open}/>"));
    }
    line(xml, 2, &format!("{open}>"));
    for port in &manifest.ports {
        port_model(xml, port);
    }
    line(xml, 2, &format!("</{tag}>"));
}

fn port_model(xml: &mut String, port: &PortSpec) {
    let tag = if port.direction == PortDirection::Input { "input_port" } else { "output_port" };
    let default = match &port.presence {
        PortPresence::Default(text) => attribute("default", text),
        PortPresence::Required | PortPresence::Optional => String::new(),
    };
    line(
        xml,
        3,
        &format!("<{tag}{}{}{default}/>", attribute("name", &port.name), attribute("type", port.port_type.name())),
    );
}

fn line(xml: &mut String, depth: usize, text: &str) {
    // Writing into a string cannot fail.
    let _ = writeln!(xml, "{:1$}{text}", "", depth * 2);
}

/// Returns ` name="value"`, escaped.
fn attribute(name: &str, value: &str) -> String {
    let mut text = format!(" {name}=\"");
    for c in value.chars() {
        match c {
            '&' => text += "&amp;",
            '<' => text += "&lt;",
            '>' => text += "&gt;",
            '"' => text += "&quot;",
            // A parser would turn these into spaces.
            '\n' | '\r' | '\t' => {
                let _ = write!(text, "&#{};", u32::from(c));
            }
            c => text.push(c),
        }
    }
    text + "\""
}
