//! Bounded parsing of untrusted XML: a small text cannot expand to a large document, or take long
//! to parse.
//!
//! The parser compares each attribute of an element with all earlier attributes, and passes
//! namespaces on to every inner element. Both costs grow with the square of the input. Both are
//! therefore counted before parsing. Entities are rejected with their DTD.

use roxmltree::{Document, ParsingOptions};
use std::fmt;

/// Greatest number of attributes of an element. Nodes of trees and shapes of drawings have a dozen.
pub(crate) const MAX_ATTRIBUTES: usize = 256;

/// Greatest number of namespace declarations in a text. Trees and drawings have none, and editors
/// add a few.
pub(crate) const MAX_NAMESPACES: usize = 64;

/// A text is not parsed.
#[derive(Debug, Clone, PartialEq)]
pub enum XmlError {
    /// An element has more than `MAX_ATTRIBUTES`.
    Attributes {
        /// Line where the element begins, from 1.
        line: u32,
    },
    /// The text has more than `MAX_NAMESPACES`.
    Namespaces {
        /// Line of the element that exceeds the limit, from 1.
        line: u32,
    },
    /// The text is not XML, or has too many nodes.
    Syntax(roxmltree::Error),
}

impl XmlError {
    /// Line of the error, from 1.
    pub fn line(&self) -> u32 {
        match self {
            XmlError::Attributes { line } | XmlError::Namespaces { line } => *line,
            XmlError::Syntax(error) => error.pos().row,
        }
    }
}

impl fmt::Display for XmlError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            XmlError::Attributes { line } => {
                write!(f, "the element in line {line} has more than the {MAX_ATTRIBUTES} attributes allowed")
            }
            XmlError::Namespaces { line } => {
                write!(f, "more than the {MAX_NAMESPACES} allowed namespaces are declared up to line {line}")
            }
            XmlError::Syntax(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for XmlError {}

/// Parses a text with at most `nodes_max` nodes: elements, and the texts and comments between them.
/// A DTD is rejected.
///
/// # Errors
/// [`XmlError`] with the line.
pub fn parse(text: &str, nodes_max: u32) -> Result<Document<'_>, XmlError> {
    count(text)?;
    let options = ParsingOptions { allow_dtd: false, nodes_limit: nodes_max, ..ParsingOptions::default() };
    Document::parse_with_options(text, options).map_err(XmlError::Syntax)
}

/// Examines only tags. In a text that is not XML it may find other tags than the parser, which
/// stops there.
fn count(text: &str) -> Result<(), XmlError> {
    let mut rest = text;
    let line_at = |rest: &str| {
        let before = &text.as_bytes()[..text.len() - rest.len()];
        u32::try_from(before.iter().filter(|byte| **byte == b'\n').count()).unwrap_or(u32::MAX).saturating_add(1)
    };
    let mut namespaces = 0;
    while let Some(begin) = rest.find('<') {
        let tag = &rest[begin..];
        let plain = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")];
        if let Some((open, close)) = plain.into_iter().find(|(open, _)| tag.starts_with(open)) {
            let Some(end) = tag[open.len()..].find(close) else { return Ok(()) };
            rest = &tag[open.len() + end + close.len()..];
            continue;
        }
        let (mut quote, mut attributes, mut length) = (None, 0, tag.len());
        for (at, byte) in tag.bytes().enumerate() {
            match (quote, byte) {
                (Some(open), _) if byte == open => quote = None,
                (Some(_), _) => {}
                (None, b'"' | b'\'') => quote = Some(byte),
                (None, b'=') => attributes += 1,
                (None, b'x') if tag.as_bytes()[at..].starts_with(b"xmlns") => namespaces += 1,
                (None, b'>') => {
                    length = at + 1;
                    break;
                }
                (None, _) => {}
            }
            if attributes > MAX_ATTRIBUTES {
                return Err(XmlError::Attributes { line: line_at(tag) });
            }
        }
        if namespaces > MAX_NAMESPACES {
            return Err(XmlError::Namespaces { line: line_at(tag) });
        }
        rest = &tag[length..];
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(attributes: usize) -> String {
        let attributes: String = (0..attributes).map(|nth| format!(" a{nth}='=>x'")).collect();
        format!("<?xml version='1.0'?>\n<!-- <a b='1' -->\n<a><b{attributes}/><![CDATA[ <c d= ]]></a>")
    }

    #[test]
    fn attributes_are_counted_element_by_element() {
        let text = with(MAX_ATTRIBUTES);
        assert_eq!(parse(&text, 10).unwrap().root_element().first_element_child().unwrap().attributes().len(), 256);
        let text = with(MAX_ATTRIBUTES + 1);
        let why = parse(&text, 10).unwrap_err();
        assert_eq!(why.to_string(), "the element in line 3 has more than the 256 attributes allowed");
        assert_eq!(why.line(), 3);
    }

    #[test]
    fn namespaces_are_counted_over_the_whole_text() {
        let of = |count: usize| {
            let open: String = (0..count).map(|nth| format!("<a xmlns:n{nth}='u{nth}' b='xmlns'>\n")).collect();
            format!("{open}{}", "</a>".repeat(count))
        };
        assert!(parse(&of(MAX_NAMESPACES), 1000).is_ok());
        assert_eq!(parse(&of(MAX_NAMESPACES + 1), 1000).unwrap_err(), XmlError::Namespaces { line: 65 });
    }

    #[test]
    fn the_parser_counts_nodes_and_rejects_a_dtd() {
        assert!(parse("<a><b/></a>", 3).is_ok());
        assert_eq!(parse("<a><b/></a>", 2).unwrap_err().to_string(), "nodes limit reached");
        assert!(parse("<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>", 9).unwrap_err().to_string().contains("DTD"));
    }
}
