//! What a step says: the values of its parameters, its table and its text.

use super::step_pattern::StepFailure;
use std::fmt::Display;
use std::str::FromStr;

/// What was said.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct StepArguments {
    pub(super) values: Vec<String>,
    pub(super) table: Option<Vec<Vec<String>>>,
    pub(super) docstring: Option<String>,
}

impl StepArguments {
    /// A parameter as it stands there, without its quotes.
    pub(super) fn value(&self, index: usize) -> &str {
        self.values[index].trim_matches('"')
    }

    /// A name of some kind.
    pub(super) fn parse_name<T: FromStr<Err: Display>>(&self, index: usize) -> Result<T, StepFailure> {
        name(self.value(index))
    }

    /// A number, whatever unit follows it.
    pub(super) fn number(&self, index: usize) -> f64 {
        let digits = self.value(index).split([' ', '%']).next().unwrap_or_default();
        digits.parse().expect("the phrase's own pattern lets numbers through alone")
    }

    /// A time in seconds.
    pub(super) fn seconds(&self, index: usize) -> f64 {
        let unit = self.value(index).split(' ').nth(1).unwrap_or_default();
        let seconds = match unit {
            "ms" => 0.001,
            _ if unit.starts_with('m') => 60.0,
            _ if unit.starts_with('h') => 3600.0,
            _ => 1.0,
        };
        self.number(index) * seconds
    }

    /// A share in percent, from 0 to 1.
    pub(super) fn share(&self, index: usize) -> f64 {
        self.number(index) / 100.0
    }

    /// Names with commas or `and` between them.
    pub(super) fn names(&self, index: usize) -> Vec<String> {
        split_list(self.value(index))
    }

    /// The rows of the table, each by the names of its columns.
    pub(super) fn rows(&self, columns: &[&str]) -> Result<Vec<TableRow>, StepFailure> {
        let Some((heads, rows)) = self.table.as_ref().and_then(|table| table.split_first()) else {
            return Err(StepFailure::Invalid(format!("it needs a table with columns of {}", columns.join(", "))));
        };
        if let Some(strange) = heads.iter().find(|head| !columns.contains(&head.as_str())) {
            return Err(StepFailure::Invalid(format!(
                "there is no column {strange:?}; there are {}",
                columns.join(", ")
            )));
        }
        let row = |cells: &Vec<String>| TableRow(heads.iter().cloned().zip(cells.iter().cloned()).collect());
        Ok(rows.iter().map(row).collect())
    }
}

/// A row of a table.
pub(super) struct TableRow(Vec<(String, String)>);

impl TableRow {
    /// What stands in a column; nothing if it is not there or empty.
    pub(super) fn cell(&self, column: &str) -> Option<&str> {
        let cell = self.0.iter().find(|(head, _)| head == column).map(|(_, cell)| cell.trim());
        cell.filter(|cell| !cell.is_empty())
    }

    /// What must stand in a column.
    pub(super) fn required(&self, column: &str) -> Result<&str, StepFailure> {
        self.cell(column).ok_or_else(|| StepFailure::Invalid(format!("every row needs a {column}")))
    }

    /// A number, with or without its unit: `0.6`, `0.6 m/s`, `90 %`.
    pub(super) fn number(&self, column: &str) -> Result<Option<f64>, StepFailure> {
        let Some(cell) = self.cell(column) else { return Ok(None) };
        let digits = cell.split([' ', '%']).next().unwrap_or_default();
        let number = digits.parse().map_err(|_| StepFailure::Invalid(format!("{column}: {cell:?} is no number")))?;
        Ok(Some(number))
    }
}

/// Names with commas or `and` between them.
pub(super) fn split_list(text: &str) -> Vec<String> {
    text.split(',').flat_map(|part| part.split(" and ")).map(|part| part.trim().to_owned()).collect()
}

/// A name of some kind, or what is wrong with it.
pub(super) fn name<T: FromStr<Err: Display>>(text: &str) -> Result<T, StepFailure> {
    text.parse().map_err(|problem: T::Err| StepFailure::Invalid(problem.to_string()))
}
