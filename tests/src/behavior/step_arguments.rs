//! Arguments of a step: the values of its parameters, its table and its docstring.

use super::step_result::StepFailure;
use std::fmt::Display;
use std::str::FromStr;

/// Arguments of a step.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StepArguments {
    pub(super) values: Vec<String>,
    pub(super) table: Option<Vec<Vec<String>>>,
    pub(super) docstring: Option<String>,
}

impl StepArguments {
    /// Returns a value without its quotes.
    pub fn value(&self, index: usize) -> &str {
        self.values[index].trim_matches('"')
    }

    /// Parses a value as a name.
    ///
    /// # Errors
    /// [`StepFailure::Invalid`] if it is no such name.
    pub fn parse_name<T: FromStr<Err: Display>>(&self, index: usize) -> Result<T, StepFailure> {
        name(self.value(index))
    }

    /// Parses a value as a number, with any unit.
    pub fn number(&self, index: usize) -> f64 {
        let digits = self.value(index).split([' ', '%']).next().unwrap_or_default();
        digits.parse().expect("the phrase's own pattern lets numbers through alone")
    }

    /// Parses a value as a time in seconds.
    pub fn seconds(&self, index: usize) -> f64 {
        let unit = self.value(index).split(' ').nth(1).unwrap_or_default();
        let seconds = match unit {
            "ms" => 0.001,
            _ if unit.starts_with('m') => 60.0,
            _ if unit.starts_with('h') => 3600.0,
            _ => 1.0,
        };
        self.number(index) * seconds
    }

    /// Parses a value in percent as a share from 0 to 1.
    pub fn share(&self, index: usize) -> f64 {
        self.number(index) / 100.0
    }

    /// Parses a value as names separated by commas or `and`.
    pub fn names(&self, index: usize) -> Vec<String> {
        split_list(self.value(index))
    }

    /// Returns the values of a table of two lines by their names; none without a table.
    pub(super) fn named_values(&self) -> Result<Vec<(&str, &str)>, StepFailure> {
        match self.table.as_deref() {
            None => Ok(vec![]),
            Some([names, values]) => {
                Ok(names.iter().map(String::as_str).zip(values.iter().map(String::as_str)).collect())
            }
            Some(_) => Err(StepFailure::invalid("its parameters are a table of two lines: names, and values")),
        }
    }

    /// Returns the rows of the table, keyed by column name.
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

/// Row of a table.
pub(super) struct TableRow(Vec<(String, String)>);

impl TableRow {
    /// Returns the cell of a column; `None` if it is missing or empty.
    pub(super) fn cell(&self, column: &str) -> Option<&str> {
        let cell = self.0.iter().find(|(head, _)| head == column).map(|(_, cell)| cell.trim());
        cell.filter(|cell| !cell.is_empty())
    }

    /// Returns the cell of a required column.
    pub(super) fn required(&self, column: &str) -> Result<&str, StepFailure> {
        self.cell(column).ok_or_else(|| StepFailure::Invalid(format!("every row needs a {column}")))
    }

    /// Parses a cell as a number, with or without a unit: `0.6`, `0.6 m/s`, `90 %`.
    pub(super) fn number(&self, column: &str) -> Result<Option<f64>, StepFailure> {
        let Some(cell) = self.cell(column) else { return Ok(None) };
        let digits = cell.split([' ', '%']).next().unwrap_or_default();
        let number = digits.parse().map_err(|_| StepFailure::Invalid(format!("{column}: {cell:?} is no number")))?;
        Ok(Some(number))
    }
}

/// Splits names at commas and `and`.
pub(super) fn split_list(text: &str) -> Vec<String> {
    text.split(',').flat_map(|part| part.split(" and ")).map(|part| part.trim().to_owned()).collect()
}

/// Parses a name.
pub(super) fn name<T: FromStr<Err: Display>>(text: &str) -> Result<T, StepFailure> {
    text.parse().map_err(|problem: T::Err| StepFailure::Invalid(problem.to_string()))
}
