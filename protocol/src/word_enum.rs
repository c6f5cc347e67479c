//! Enums with a fixed word for each variant, as used in keys, certificates and files.

/// Defines enums with a word for each variant, a list of all variants, and a parser.
macro_rules! words {
    ($($(#[$doc:meta])* $name:ident { $($(#[$vdoc:meta])* $variant:ident = $word:literal),* $(,)? })*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
        pub enum $name { $($(#[$vdoc])* $variant),* }

        impl $name {
            /// All variants.
            pub const ALL: &'static [$name] = &[$($name::$variant),*];

            /// Returns the word of the variant, as written in a key.
            pub fn as_str(self) -> &'static str {
                match self { $($name::$variant => $word),* }
            }

            /// Returns the variant with this word; `None` for any other word.
            pub fn parse(word: &str) -> Option<$name> {
                $name::ALL.iter().copied().find(|call| call.as_str() == word)
            }
        }
    )*};
}

pub(crate) use words;
