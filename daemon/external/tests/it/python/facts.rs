//! Facts about an object, by which a run can be repeated.

use std::fs;
use std::path::Path;

use super::Module;

/// Returns the files of the fact `Model files` as paths below a folder. Checks the hashes of the files.
fn files(facts: &[(String, String)], folder: &Path) -> Vec<String> {
    let folder = folder.canonicalize().expect("is there");
    let (_, files_fact) =
        facts.iter().find(|(name, _)| name == "Model files").expect("the files are reported");
    let file = |file_fact: &str| {
        let (path, hash) = file_fact.split_once(" SHA-256 ").expect("has a hash");
        let bytes = fs::read(path).expect("is there");
        assert_eq!(hash, peernet_external::sha256(bytes.as_slice()).expect("is read"));
        Path::new(path).strip_prefix(&folder).expect("is a file of custom code").display().to_string()
    };
    files_fact.split(", ").map(file).collect()
}

fn libraries(facts: &[(String, String)]) -> Vec<&str> {
    let libraries_fact = facts.iter().find(|(name, _)| name == "Model libraries");
    libraries_fact.map_or_else(Vec::new, |(_, libraries_fact)| libraries_fact.split(", ").collect())
}

#[test]
fn description_contains_file_and_libraries() {
    let source = "import json, numpy\nclass Own:\n    def infer(self, x): return x\n";
    let module = Module::new(source, "own::Own");
    let facts = module.model().description().facts("Model");
    let names: Vec<&str> = facts.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["Model", "Model interpreter", "Model files", "Model libraries"]);
    assert!(facts[0].1.starts_with("the Python class own::Own, Python 3."), "{facts:?}");
    assert_eq!(files(&facts, module.folder.path()), ["own.py"]);
    let libraries = libraries(&facts);
    assert!(libraries.iter().any(|library| library.starts_with("numpy ")), "{libraries:?}");
    assert!(libraries.iter().all(|library| !library.starts_with("json")), "{libraries:?}");
}

#[test]
fn object_files_are_found_without_running_code() {
    let source = "
from rig import lens
try:
    import nowhere
except ImportError:
    nowhere = None

class Own:
    def infer(self, x):
        import numpy
        from later.steps import last
        return x
";
    let module = Module::new(source, "own::Own");
    let folder = module.folder.path();
    let failing_source = "raise SystemExit('nobody is to run this')\n";
    for (file, text) in [
        ("rig/__init__.py", ""),
        // A cycle of imports, and a broken file that is imported by a function that is never called.
        ("rig/lens.py", "from . import glass\ndef never():\n    from .broken import pieces\n"),
        ("rig/glass.py", "import rig.lens as whole\n"),
        ("rig/broken.py", "def (\n"),
        ("rig/unused.py", failing_source),
        ("later/steps.py", &format!("import unseen\n{failing_source}")),
        ("unseen.py", failing_source),
    ] {
        let path = folder.join(file);
        fs::create_dir_all(path.parent().expect("is below the folder")).expect("writable");
        fs::write(path, text).expect("writable");
    }
    let facts = module.model().description().facts("Model");
    assert_eq!(
        files(&facts, folder),
        [
            "own.py",
            "rig/__init__.py",
            "rig/lens.py",
            "later/steps.py",
            "rig/glass.py",
            "rig/broken.py",
            "unseen.py",
        ]
    );
    let libraries = libraries(&facts);
    assert!(libraries.iter().any(|library| library.starts_with("numpy 1") || library.starts_with("numpy 2")));
    assert!(
        facts.iter().all(|(name, _)| name != "Model imports"),
        "a fact says that the list of files is incomplete: {facts:?}"
    );
}

#[test]
fn dynamic_imports_and_adjacent_packages_are_recorded() {
    let source = "
import importlib
driver = importlib.import_module('driv' + 'er')
import bought
class Own:
    def infer(self, x): return x
";
    let module = Module::new(source, "own::Own");
    let folder = module.folder.path();
    let write = |file: &str, text: &str| {
        let path = folder.join(file);
        fs::create_dir_all(path.parent().expect("is below the folder")).expect("writable");
        fs::write(path, text).expect("writable");
    };
    write("driver.py", "import gears\n");
    write("gears.py", "");
    // Layout of `pip install --target`.
    write("bought/__init__.py", "import bought.inside\n");
    write("bought/inside.py", "");
    write("Some_Name-2.5.dist-info/RECORD", "bought/__init__.py,sha256=x,20\nbought/inside.py,sha256=x,0\n");
    let facts = module.model().description().facts("Model");
    let mut files = files(&facts, folder);
    files.sort_unstable();
    assert_eq!(files, ["driver.py", "gears.py", "own.py"]);
    assert!(libraries(&facts).contains(&"bought 2.5"), "{facts:?}");
}

#[test]
fn sensor_that_imports_nothing_has_no_libraries() {
    let module = Module::new("class Own:\n    def sample(self): return b'1'\n", "own::Own");
    let facts = module.sensor().description().facts("Sensor");
    let names: Vec<&str> = facts.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["Sensor", "Sensor interpreter", "Sensor files"]);
    let source = "import PIL.Image\nclass Own:\n    def sample(self): return PIL.Image.new('L', (1, 1))\n";
    let module = Module::new(source, "own::Own");
    let facts = module.sensor().description().facts("Sensor");
    let (name, libraries_fact) = facts.last().expect("there are facts");
    assert!(name == "Sensor libraries" && libraries_fact.contains("PIL "), "{facts:?}");
}

#[test]
fn module_in_zipped_egg_is_hashed_as_egg() {
    let source = "
import sys, zipfile
with zipfile.ZipFile('gear.egg', 'w') as egg:
    egg.writestr('geared.py', 'import gears.small')
    egg.writestr('gears/__init__.py', '')
    egg.writestr('gears/small.py', '')
sys.path.append('gear.egg')
import geared
class Own:
    def infer(self, x): return x
";
    let module = Module::new(source, "own::Own");
    let facts = module.model().description().facts("Model");
    let folder = module.folder.path().canonicalize().expect("is there");
    let bytes = fs::read(folder.join("gear.egg")).expect("was made");
    let hash = peernet_external::sha256(bytes.as_slice()).expect("is read");
    let (_, files_fact) =
        facts.iter().find(|(name, _)| name == "Model files").expect("the files are reported");
    let entries: Vec<&str> = files_fact.split(", ").collect();
    assert!(entries.len() == 2 && entries[0].contains("/own.py SHA-256 "), "{files_fact}");
    assert_eq!(entries[1], format!("{}/gear.egg SHA-256 {hash}", folder.display()));
}

#[test]
fn more_than_64_files_are_reported_as_incomplete() {
    let imports: String = (0..80).map(|number| format!("import part_{number}\n")).collect();
    let module = Module::new(&format!("{imports}class Own:\n    def infer(self, x): return x\n"), "own::Own");
    for number in 0..80 {
        let path = module.folder.path().join(format!("part_{number}.py"));
        fs::write(path, format!("VALUE = {number}\n")).expect("writable");
    }
    let facts = module.model().description().facts("Model");
    assert_eq!(files(&facts, module.folder.path()).len(), 64);
    let (name, imports_fact) = facts.last().expect("there are facts");
    assert!(name == "Model imports" && imports_fact.contains("incomplete"), "{facts:?}");
}

#[test]
fn object_with_misleading_attributes_is_described() {
    for statement in [
        "__file__ = None",
        "del __file__",
        "__file__ = 'a' * (2 << 20)",
        "__file__ = '\\udcff\\x1b[31m'",
        "sys.modules['numpy'] = types.SimpleNamespace(__version__='\\ud800\\x1b')",
        "class Odd:\n    def __getattr__(self, name): raise OSError(name)\nsys.modules['torch'] = Odd()",
        "sys.modules['torch'] = None",
        "sys.modules[7] = sys",
        "__path__ = 7",
        "sys.path.append(None)",
    ] {
        let source =
            format!("import sys, types\n{statement}\nclass Own:\n    def infer(self, x): return x\n");
        let module = Module::new(&source, "own::Own");
        let facts = module.model().description().facts("Model");
        assert_eq!(facts[0].0, "Model");
        assert!(
            facts.iter().all(|(_, fact)| !fact.contains('\x1b') && fact.len() < 9000),
            "{statement}: {facts:?}"
        );
    }
}
