//! Choices that stand in keys, certificates and files as one word each.

/// Enums of which each variant has a word, all of them listed and read back.
macro_rules! words {
    ($($(#[$doc:meta])* $name:ident { $($(#[$vdoc:meta])* $variant:ident = $word:literal),* $(,)? })*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
        pub enum $name { $($(#[$vdoc])* $variant),* }

        impl $name {
            /// All of them.
            pub const ALL: &'static [$name] = &[$($name::$variant),*];

            /// The word that stands for it in a key.
            pub fn as_str(self) -> &'static str {
                match self { $($name::$variant => $word),* }
            }

            /// Which of them a word stands for, if any.
            pub fn parse(word: &str) -> Option<$name> {
                $name::ALL.iter().copied().find(|call| call.as_str() == word)
            }
        }
    )*};
}

pub(crate) use words;
