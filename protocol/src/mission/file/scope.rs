//! Scope of a task in a mission file: the loops and conditions around it.

use crate::ids::TaskId;
use std::collections::{BTreeMap, BTreeSet};

/// Loops and conditions around a task.
#[derive(Debug, Clone, Default)]
pub(super) struct Scope {
    /// Values of loop variables, by name.
    pub(super) values: BTreeMap<String, String>,
    /// Conditions under which the task is executed.
    pub(super) conditions: Vec<String>,
    /// Suffix of the names of tasks in the iterations.
    suffix: String,
    /// Names with suffix of the tasks in iterations, by their names in the file.
    renamed: BTreeMap<String, String>,
    /// Names with suffix of the roles in iterations that are spread over robots, by their names in the file.
    renamed_roles: BTreeMap<String, String>,
}

impl Scope {
    /// Returns the scope of an iteration, counted from 1, over the `tasks` of its body.
    pub(super) fn iteration(&self, number: usize, tasks: &BTreeSet<&str>) -> Scope {
        let suffix = format!("{}_{number}", self.suffix);
        let renamed = tasks.iter().map(|task| ((*task).to_owned(), format!("{task}{suffix}")));
        let renamed = self.renamed.clone().into_iter().chain(renamed).collect();
        Scope { suffix, renamed, ..self.clone() }
    }

    /// Returns the scope with roles of this iteration alone. Their names are also values.
    pub(super) fn with_own_roles(mut self, roles: &BTreeSet<&str>) -> Scope {
        for role in roles {
            let renamed = format!("{role}{}", self.suffix);
            self.values.insert((*role).to_owned(), renamed.clone());
            self.renamed_roles.insert((*role).to_owned(), renamed);
        }
        self
    }

    /// Returns the scope with a further condition.
    pub(super) fn with_condition(mut self, condition: String) -> Scope {
        self.conditions.push(condition);
        self
    }

    /// Returns the scope without its conditions.
    pub(super) fn without_conditions(&self) -> Scope {
        Scope { conditions: vec![], ..self.clone() }
    }

    /// Returns the name of a task in this iteration.
    pub(super) fn task_name(&self, task: &str) -> String {
        self.renamed.get(task).cloned().unwrap_or_else(|| task.to_owned())
    }

    /// Returns the name of a role in this iteration, if it is a role of the iteration alone.
    pub(super) fn own_role(&self, role: &str) -> Option<&str> {
        self.renamed_roles.get(role).map(String::as_str)
    }

    /// Returns the name of a task that is referred to.
    pub(super) fn task_id(&self, task: &str) -> Option<TaskId> {
        TaskId::new(self.task_name(task)).ok()
    }

    /// Returns an expression with the names of tasks as in this iteration, and with the values that
    /// `literal` returns for `${name}`.
    ///
    /// # Errors
    /// Those of `literal`, and a `${` that is not closed.
    pub(super) fn expression<E>(
        &self,
        text: &str,
        mut literal: impl FnMut(&str) -> Result<String, E>,
        unclosed: impl Fn() -> E,
    ) -> Result<String, E> {
        let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
        let mut result = String::new();
        let mut rest = text;
        while let Some(first) = rest.chars().next() {
            let length = match first {
                '\'' | '"' => text_literal_length(rest, first),
                '$' if rest.starts_with("${") => {
                    let (name, after) = rest[2..].split_once('}').ok_or_else(&unclosed)?;
                    result.push_str(&literal(name)?);
                    rest = after;
                    continue;
                }
                c if is_name(c) => rest.find(|c: char| !is_name(c)).unwrap_or(rest.len()),
                c => c.len_utf8(),
            };
            let (token, after) = rest.split_at(length);
            match self.renamed.get(token).filter(|_| !result.trim_end().ends_with('.')) {
                Some(name) => result.push_str(name),
                None => result.push_str(token),
            }
            rest = after;
        }
        Ok(result)
    }
}

/// Returns the length of the text literal at the start, with its quotes.
fn text_literal_length(text: &str, quote: char) -> usize {
    let mut is_escaped = false;
    for (at, c) in text.char_indices().skip(1) {
        match c {
            '\\' if !is_escaped => is_escaped = true,
            c if c == quote && !is_escaped => return at + c.len_utf8(),
            _ => is_escaped = false,
        }
    }
    text.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expression(text: &str) -> Result<String, String> {
        let scope = Scope::default().iteration(2, &BTreeSet::from(["inspect", "a"]));
        let literal = |name: &str| if name == "limit" { Ok("5.0".to_owned()) } else { Err(name.to_owned()) };
        scope.expression(text, literal, || "unclosed".to_owned())
    }

    #[test]
    fn tasks_are_renamed_and_parameters_inserted() {
        for (text, expected) in [
            ("inspect.dust > ${limit}", "inspect_2.dust > 5.0"),
            ("inspect.inspect == 'inspect' && x.a", "inspect_2.inspect == 'inspect' && x.a"),
            (r#"a.b == "it's a \" a" || inspected.a"#, r#"a_2.b == "it's a \" a" || inspected.a"#),
            ("'${limit}' == é", "'${limit}' == é"),
        ] {
            assert_eq!(expression(text).unwrap(), expected);
        }
        assert_eq!(expression("${other} > 1"), Err("other".to_owned()));
        assert_eq!(expression("${limit > 1"), Err("unclosed".to_owned()));
    }
}
