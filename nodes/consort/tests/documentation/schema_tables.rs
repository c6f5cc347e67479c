//! Tables from a JSON Schema: a section per object, a row per key.

use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Writer of sections. An object with an existing section is only linked.
#[derive(Default)]
pub(crate) struct SchemaTables {
    /// True for replies of nodes: they have no defaults.
    replies: bool,
    text: String,
    /// Anchors of the sections, by object name.
    anchors: BTreeMap<String, String>,
}

impl SchemaTables {
    /// Creates a writer for the JSON that nodes write.
    pub(crate) fn of_replies() -> SchemaTables {
        SchemaTables { replies: true, ..SchemaTables::default() }
    }

    /// Adds the sections of a file kind; `depth` is the level of the first heading.
    pub(crate) fn file(&mut self, depth: usize, title: &str, kind: &str, schema: &Value) {
        let name = schema["title"].as_str().expect("schemas of files have a title").to_owned();
        self.anchors.insert(name, anchor(title));
        writeln!(self.text, "{} {title}\n\n{}\n", "#".repeat(depth), meaning(schema)).expect("text grows");
        self.object(depth + 1, kind, schema, &schema["$defs"]);
    }

    pub(crate) fn text(self) -> String {
        self.text.trim_end().to_owned() + "\n"
    }

    /// Adds the table of an object, followed by the tables of objects that first appear in it.
    fn object(&mut self, depth: usize, path: &str, object: &Value, defs: &Value) {
        let none = Map::new();
        let properties = object["properties"].as_object().unwrap_or(&none);
        let required: Vec<&str> =
            object["required"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        // Required keys come first.
        let (mut must, may): (Vec<_>, Vec<_>) =
            properties.iter().partition(|(key, _)| required.contains(&key.as_str()));
        if self.replies {
            // In the order of the declaration.
            must.sort_by_key(|(key, _)| required.iter().position(|name| name == key));
        }
        let properties = [must, may].concat();
        let mut met = vec![];
        // The section titles must be known first, because rows link to them.
        for (key, schema) in &properties {
            for name in objects(schema, defs) {
                if !self.anchors.contains_key(&name) {
                    let title = format!("{path}: {key}");
                    self.anchors.insert(name.clone(), anchor(&title));
                    met.push((name, title));
                }
            }
        }
        if !properties.is_empty() {
            self.text.push_str(match self.replies {
                true => "| key | what | meaning |\n|---|---|---|\n",
                false => "| key | what | default | meaning |\n|---|---|---|---|\n",
            });
        }
        for (key, schema) in &properties {
            let default = match &schema["default"] {
                _ if required.contains(&key.as_str()) => "must be there".to_owned(),
                Value::Null => "–".to_owned(),
                Value::Array(list) if list.is_empty() => "none".to_owned(),
                Value::Object(table) if table.is_empty() => "none".to_owned(),
                Value::Object(_) => "as below".to_owned(),
                value => format!("`{value}`"),
            };
            let (what, meaning) = (self.what(schema, defs), meaning(schema));
            let default = if self.replies { String::new() } else { format!(" {default} |") };
            writeln!(self.text, "| `{key}` | {what} |{default} {meaning} |").expect("text grows");
        }
        if !properties.is_empty() {
            self.text.push('\n');
        }
        for (name, title) in met {
            let def = &defs[&name];
            writeln!(self.text, "{} {title}\n\n{}\n", "#".repeat(depth), meaning(def)).expect("text grows");
            self.object(depth + 1, &title, def, defs);
            for variant in variants(def) {
                let kind = &variant["properties"]["kind"]["const"];
                writeln!(self.text, "With `kind = {kind}`: {}\n", meaning(variant)).expect("text grows");
                let inner = variant["$ref"].as_str().map(|to| &defs[name_of(to)]);
                self.object(depth + 1, &title, inner.unwrap_or(variant), defs);
            }
        }
    }

    /// Describes the type of a value.
    fn what(&self, schema: &Value, defs: &Value) -> String {
        if let Some(to) = schema["$ref"].as_str() {
            let name = name_of(to);
            return match (words(&defs[name]), self.anchors.get(name)) {
                (Some(words), _) => words,
                (None, Some(anchor)) => format!("[table](#{anchor})"),
                (None, None) => self.what(&defs[name], defs),
            };
        }
        if let Some(words) = words(schema) {
            return words;
        }
        if let Some(several) = schema["anyOf"].as_array() {
            let each = several.iter().filter(|one| one["type"] != "null").map(|one| self.what(one, defs));
            return each.collect::<Vec<_>>().join(" or ");
        }
        let bounds = |one: &str| {
            let bound = |key: &str| schema[key].as_f64();
            match (bound("minimum"), bound("exclusiveMinimum"), bound("maximum")) {
                (Some(least), _, Some(most)) => format!("{one}, {least} to {most}"),
                (Some(least), ..) => format!("{one}, {least} or more"),
                (_, Some(least), _) => format!("{one} above {least}"),
                _ => one.to_owned(),
            }
        };
        let kind = match &schema["type"] {
            Value::String(kind) => kind.as_str(),
            Value::Array(kinds) => {
                let kinds: Vec<&str> = kinds.iter().filter_map(Value::as_str).filter(|kind| *kind != "null").collect();
                if let [_, _, ..] = kinds[..] {
                    let each = kinds.iter().map(|kind| self.what(&json!({ "type": kind }), defs));
                    return each.collect::<Vec<_>>().join(" or ");
                }
                kinds.first().copied().unwrap_or_default()
            }
            _ => "",
        };
        match kind {
            "string" if !schema["pattern"].is_null() => "name".to_owned(),
            "string" => "text".to_owned(),
            "boolean" => "`true` or `false`".to_owned(),
            "integer" => bounds("whole number"),
            "number" => bounds("number"),
            "array" => match &schema["prefixItems"] {
                Value::Array(items) => {
                    let items: Vec<String> = items.iter().map(|item| self.what(item, defs)).collect();
                    format!("[{}]", items.join(", "))
                }
                _ => format!("list of: {}", self.what(&schema["items"], defs)),
            },
            "object" => {
                let patterns = schema["patternProperties"].as_object().and_then(|patterns| patterns.values().next());
                format!("by name: {}", self.what(patterns.unwrap_or(&schema["additionalProperties"]), defs))
            }
            _ => "anything".to_owned(),
        }
    }
}

/// Returns the variants of an object, distinguished by the key `kind`.
fn variants(def: &Value) -> impl Iterator<Item = &Value> {
    let several = def["oneOf"].as_array().into_iter().flatten();
    several.filter(|variant| !variant["properties"]["kind"].is_null())
}

/// Returns the allowed words, if the schema lists them.
fn words(schema: &Value) -> Option<String> {
    if let Some(word) = schema["const"].as_str() {
        return Some(format!("`{word:?}`"));
    }
    let listed = schema["enum"].as_array().cloned();
    let each = || {
        let one_of = schema["oneOf"].as_array()?.iter();
        one_of.map(|one| Some(one["const"].clone()).filter(|word| !word.is_null())).collect::<Option<Vec<_>>>()
    };
    let words = listed.or_else(each)?;
    let words: Vec<String> = words.iter().filter(|word| !word.is_null()).map(|word| format!("`{word}`")).collect();
    Some(words.join(", "))
}

/// Returns the objects in a value that have their own sections.
fn objects(schema: &Value, defs: &Value) -> Vec<String> {
    let mut found = vec![];
    if let Some(name) = schema["$ref"].as_str().map(name_of) {
        let def = &defs[name];
        if def["properties"].is_object() || variants(def).next().is_some() {
            found.push(name.to_owned());
        }
    }
    let several = schema["anyOf"].as_array().into_iter().flatten();
    for inner in several.chain([&schema["items"], &schema["additionalProperties"]]).filter(|inner| inner.is_object()) {
        found.extend(objects(inner, defs));
    }
    found
}

fn name_of(reference: &str) -> &str {
    reference.trim_start_matches("#/$defs/").trim_start_matches('#')
}

fn anchor(title: &str) -> String {
    super::page::anchor_of(title)
}

/// Returns the comment of a schema as a table cell.
pub(crate) fn meaning(schema: &Value) -> String {
    plain(schema["description"].as_str().unwrap_or_default())
}

/// Returns the first paragraph of a comment in a single line, without links into the code.
pub(crate) fn plain(comment: &str) -> String {
    let comment = comment.split("\n\n").next().unwrap_or_default();
    let one_line = comment.split_whitespace().collect::<Vec<_>>().join(" ").replace('|', "\\|");
    let mut plain = String::new();
    let mut rest = one_line.as_str();
    while let Some((before, after)) = rest.split_once('[') {
        plain.push_str(before);
        match after.split_once(']') {
            // [`Name`], [`Name`](path) and [words](path); a table `[bus]` is left as it is.
            Some((inside, behind)) if inside.starts_with('`') || behind.starts_with('(') => {
                plain.push_str(inside);
                rest = match behind.strip_prefix('(').and_then(|link| link.split_once(')')) {
                    Some((_, behind)) => behind,
                    None => behind,
                };
            }
            _ => {
                plain.push('[');
                rest = after;
            }
        }
    }
    plain + rest
}

#[test]
fn doc_comments_become_plain_text() {
    assert_eq!(
        plain("A [`Leaf`](crate::x) of\na [tree](crate::y); `[bus]` [`Z`]\n\nMore."),
        "A `Leaf` of a tree; `[bus]` `Z`"
    );
}
