//! YAML files, which may come from any source.
//!
//! The depth of a text is limited while it is parsed. Anchors, aliases, merge keys and multiple
//! documents are rejected: no file needs them, and a few of them can expand to gigabytes.

use serde::de::DeserializeOwned;

fn options() -> serde_saphyr::Options {
    serde_saphyr::options! {
        budget: serde_saphyr::budget! {
            max_aliases: 0,
            max_anchors: 0,
            max_depth: 128,
            flow_nesting_limit: 128,
            max_documents: 1,
            max_nodes: 50_000,
            max_events: 100_000,
            max_merge_keys: 0,
        },
        merge_keys: serde_saphyr::options::MergeKeyPolicy::Error,
    }
}

/// Parses a text without its byte order mark. The caller has limited its size.
///
/// # Errors
/// Message of the parser, with line and column.
pub fn parse<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    let text = text.trim_start_matches('\u{feff}');
    serde_saphyr::from_str_with_options(text, options()).map_err(|error| error.to_string())
}
