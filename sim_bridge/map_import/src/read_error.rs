//! The error of a reader of a foreign form, before the file's name is added.

/// A text of a foreign form could not be read.
pub(crate) enum ReadError<Diagnostic> {
    /// The text has another form.
    Syntax(String),
    /// The content is invalid; all errors, in the order of the file.
    Invalid(Vec<Diagnostic>),
}
