//! Modules of a crate and their references to each other, read from syntax trees.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use proc_macro2::{TokenStream, TokenTree};
use syn::visit::Visit;
use syn::{Attribute, Item, ItemImpl, ItemUse, Type, UseTree, Visibility};

/// For each top-level module: the other top-level modules to which it refers, each with the first file that does.
pub(super) type Uses = BTreeMap<String, BTreeMap<String, PathBuf>>;

/// Segments of a path, as written in a module: `["super", "time", "Span"]`.
pub(crate) type Segments = Vec<String>;

/// Source file, or inline module in a source file, with the paths in it.
struct SourceFile {
    path: PathBuf,
    /// Modules from the crate's root to this module.
    module: Segments,
    /// Paths that begin with `crate`, `super` or `self`.
    references: Vec<Segments>,
}

/// Returns the references between the top-level modules of a crate, without code that is compiled for tests only.
/// `root` is the crate's root file.
pub(super) fn uses(root: &Path) -> Uses {
    let mut reader = Reader::default();
    reader.read(root, &[], root.parent().expect("in a folder"));
    let top_level_modules: BTreeSet<&String> =
        reader.files.iter().filter(|file| file.module.len() == 1).map(|file| &file.module[0]).collect();
    let mut uses: Uses = top_level_modules.iter().map(|name| ((*name).clone(), BTreeMap::new())).collect();
    for file in &reader.files {
        let Some(own_module) = file.module.first() else { continue };
        for reference in &file.references {
            let Some(target) = file.resolve(reference) else { continue };
            // A name that the root re-exports belongs to the module from which it comes.
            let target = reader.exported.get(&target).unwrap_or(&target);
            if target != own_module && top_level_modules.contains(target) {
                let module_uses = uses.get_mut(own_module).expect("each module has an entry");
                module_uses.entry(target.clone()).or_insert_with(|| file.path.clone());
            }
        }
    }
    uses
}

impl SourceFile {
    /// Returns the name directly below the crate's root that a path leads to.
    fn resolve(&self, reference: &[String]) -> Option<String> {
        let mut path = self.module.clone();
        let mut rest = reference.iter();
        for segment in rest.by_ref() {
            match segment.as_str() {
                "crate" => path.clear(),
                "self" => {}
                "super" => {
                    path.pop()?;
                }
                other => {
                    path.push(other.to_owned());
                    break;
                }
            }
        }
        path.into_iter().next()
    }
}

#[derive(Default)]
struct Reader {
    files: Vec<SourceFile>,
    /// Names that the root re-exports, each with its module.
    exported: BTreeMap<String, String>,
}

impl Reader {
    /// Reads a file and the modules that it declares, which are in `folder`.
    fn read(&mut self, path: &Path, module: &[String], folder: &Path) {
        let text =
            std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let file = syn::parse_file(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        self.add_items(&file.items, path, module, folder);
    }

    fn add_items(&mut self, items: &[Item], path: &Path, module: &[String], folder: &Path) {
        let mut collected = ReferencedPaths::default();
        let is_in_crate = |path: &Segments| ["crate", "super", "self"].contains(&path[0].as_str());
        for item in items.iter().filter(|item| !is_for_tests(attributes(item))) {
            match item {
                Item::Mod(inner) => {
                    let name = inner.ident.to_string();
                    let module_path: Segments = module.iter().cloned().chain([name.clone()]).collect();
                    if let Some((_, items)) = &inner.content {
                        self.add_items(items, path, &module_path, &folder.join(&name));
                    } else if let Some(file) = path_attribute(&inner.attrs) {
                        let file = path.parent().expect("in a folder").join(file);
                        self.read(&file, &module_path, file.parent().expect("in a folder"));
                    } else {
                        let file_path = folder.join(format!("{name}.rs"));
                        let module_folder = folder.join(&name);
                        let file = if file_path.is_file() { file_path } else { module_folder.join("mod.rs") };
                        self.read(&file, &module_path, &module_folder);
                    }
                }
                Item::Use(use_item) if module.is_empty() => self.export(use_item),
                item => collected.visit_item(item),
            }
        }
        let references = collected.paths.into_iter().filter(is_in_crate).collect();
        self.files.push(SourceFile { path: path.to_owned(), module: module.to_vec(), references });
    }

    /// Records the names that the root re-exports.
    fn export(&mut self, use_item: &ItemUse) {
        if matches!(use_item.vis, Visibility::Inherited) {
            return;
        }
        for mut path in leaves(&use_item.tree) {
            path.retain(|segment| segment != "crate" && segment != "self");
            if let (Some(first), Some(last)) = (path.first(), path.last()) {
                self.exported.insert(last.clone(), first.clone());
            }
        }
    }
}

/// Paths of more than one segment in the visited items, without paths in items for tests.
#[derive(Default)]
pub(crate) struct ReferencedPaths {
    pub(crate) paths: Vec<Segments>,
    /// Type that `Self` stands for in the current `impl`.
    self_type: Option<String>,
}

impl ReferencedPaths {
    fn add(&mut self, mut path: Segments) {
        if let (Some("Self"), Some(self_type)) = (path.first().map(String::as_str), &self.self_type) {
            path[0].clone_from(self_type);
        }
        if path.len() > 1 {
            self.paths.push(path);
        }
    }

    /// Reads paths in the arguments of a macro, whose syntax only the macro knows.
    fn add_paths_in_tokens(&mut self, tokens: TokenStream) {
        let mut path = Segments::new();
        let mut colons = 0;
        for token in tokens {
            match token {
                TokenTree::Ident(name) => {
                    if colons != 2 {
                        self.add(std::mem::take(&mut path));
                    }
                    path.push(name.to_string());
                    colons = 0;
                }
                TokenTree::Punct(mark) if mark.as_char() == ':' => colons += 1,
                other => {
                    self.add(std::mem::take(&mut path));
                    colons = 0;
                    if let TokenTree::Group(group) = other {
                        self.add_paths_in_tokens(group.stream());
                    }
                }
            }
        }
        self.add(path);
    }
}

impl<'ast> Visit<'ast> for ReferencedPaths {
    fn visit_item(&mut self, item: &'ast Item) {
        if !is_for_tests(attributes(item)) {
            syn::visit::visit_item(self, item);
        }
    }

    fn visit_item_impl(&mut self, item: &'ast ItemImpl) {
        let self_type = match &*item.self_ty {
            Type::Path(named) => named.path.segments.last().map(|segment| segment.ident.to_string()),
            _ => None,
        };
        let outer_type = std::mem::replace(&mut self.self_type, self_type);
        syn::visit::visit_item_impl(self, item);
        self.self_type = outer_type;
    }

    fn visit_item_use(&mut self, use_item: &'ast ItemUse) {
        for path in leaves(&use_item.tree) {
            self.add(path);
        }
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        self.add(path.segments.iter().map(|segment| segment.ident.to_string()).collect());
        syn::visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, macro_call: &'ast syn::Macro) {
        self.visit_path(&macro_call.path);
        self.add_paths_in_tokens(macro_call.tokens.clone());
    }

    fn visit_visibility(&mut self, _visibility: &'ast Visibility) {
        // `pub(in crate::store)` is no use of the module.
    }
}

/// Returns the paths that a `use` names.
fn leaves(tree: &UseTree) -> Vec<Segments> {
    match tree {
        UseTree::Path(path) => {
            let first = path.ident.to_string();
            leaves(&path.tree).into_iter().map(|rest| [vec![first.clone()], rest].concat()).collect()
        }
        UseTree::Name(name) => vec![vec![name.ident.to_string()]],
        UseTree::Rename(name) => vec![vec![name.ident.to_string()]],
        UseTree::Glob(_) => vec![vec!["*".to_owned()]],
        UseTree::Group(group) => group.items.iter().flat_map(leaves).collect(),
    }
}

fn attributes(item: &Item) -> &[Attribute] {
    match item {
        Item::Const(item) => &item.attrs,
        Item::Enum(item) => &item.attrs,
        Item::Fn(item) => &item.attrs,
        Item::Impl(item) => &item.attrs,
        Item::Mod(item) => &item.attrs,
        Item::Static(item) => &item.attrs,
        Item::Struct(item) => &item.attrs,
        Item::Trait(item) => &item.attrs,
        Item::Type(item) => &item.attrs,
        Item::Use(item) => &item.attrs,
        _ => &[],
    }
}

/// Returns whether an item is compiled for tests or fuzzing only: `#[cfg(test)]`, alone or with another condition, or
/// `#[cfg(fuzzing)]`.
fn is_for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().filter(|attribute| attribute.path().is_ident("cfg")).any(|attribute| {
        let syn::Meta::List(list) = &attribute.meta else { return false };
        let condition = list.tokens.to_string();
        !condition.contains("not") && (condition.contains("test") || condition.contains("fuzzing"))
    })
}

fn path_attribute(attributes: &[Attribute]) -> Option<String> {
    attributes.iter().find(|attribute| attribute.path().is_ident("path")).and_then(|attribute| {
        let syn::Meta::NameValue(pair) = &attribute.meta else { return None };
        let syn::Expr::Lit(syn::ExprLit { lit: syn::Lit::Str(text), .. }) = &pair.value else { return None };
        Some(text.value())
    })
}
