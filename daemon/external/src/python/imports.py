# Part of the worker's source: mod.rs concatenates its files. values.py imports sys; worker.py defines module_text and
# bounded_utf8.
#
# The code of a custom object: its own files, found by static analysis of imports, and the libraries.
import ast
import os
import warnings
from importlib.machinery import PathFinder

# Limit of the number of reported files of custom code, and of the number of reported libraries.
MAX_FILES = 64
# Limit of the total length of the names of these files, in characters: a host sends them to its peers in one message.
MAX_NAMES = 1 << 14
# Limit of the total source that is parsed for imports, in bytes. Parsing that much takes some tenths of a second.
MAX_SOURCE = 1 << 18
# Limit of the length of a version, in characters.
MAX_VERSION = 100
# Length of the longest path that Linux opens, in characters.
MAX_PATH = 4096
# Folder of the standard library.
STANDARD_LIBRARY = os.path.dirname(os.__file__) + os.sep
# Names of folders with installed libraries, which may be inside the folder of the standard library.
LIBRARY_FOLDERS = ("site-packages", "dist-packages")


class Imports:
    """Files and libraries that one module imports, directly or indirectly."""

    def __init__(self, folder):
        # Python searched the modules in the working folder of the start; custom code may have changed to another folder.
        self.folder = folder
        self.path = [entry or folder for entry in sys.path if isinstance(entry, str)]
        # Dictionaries keep the order of discovery.
        self.files, self.libraries = {}, {}
        # By the name of a module: the folders in which its submodules are searched; None if the module has no submodules
        # or they are not searched.
        self.package_folders = {}
        self.pending_sources, self.is_incomplete = [], False
        self.name_chars_left, self.source_bytes_left = MAX_NAMES, MAX_SOURCE
        self.distributions = {}

    def follow(self, name):
        """Records a module, the packages that contain it, and all their imports if they are the object's own files."""
        self.visit(name)
        while self.pending_sources:
            for name in imports_of(*self.pending_sources.pop(0)):
                self.visit(name)

    def visit(self, name):
        """Records a module and the packages that contain it."""
        qualified_name, search_path = "", self.path
        for part in name.split("."):
            qualified_name = qualified_name + "." + part if qualified_name else part
            if qualified_name not in self.package_folders:
                self.package_folders[qualified_name] = self.visit_module(qualified_name, search_path)
            search_path = self.package_folders[qualified_name]
            if search_path is None:
                return

    def visit_module(self, name, search_path):
        """Records a module. Returns the folders in which its submodules are searched; None if there is nothing to search."""
        file, folders = locate(name, search_path)
        location = file or (folders[0] if folders else None)
        if location is None or self.is_standard(location):
            return None
        if self.is_installed(name, location):
            if file:
                self.libraries[name] = self.version(name, file)
                return None
            # A namespace package has no file and is no library, but its submodules are libraries.
            return folders
        file = containing_archive(os.path.join(self.folder, file)) if file else None
        if file and file not in self.files:
            self.name_chars_left -= len(file)
            if len(self.files) == MAX_FILES or self.name_chars_left < 0:
                self.is_incomplete = True
                return None
            self.files[file] = None
            self.queue_source(name if folders else name.rpartition(".")[0], file)
        return folders

    def queue_source(self, package, file):
        """Parses a Python file, if MAX_SOURCE allows, and appends it to the pending sources. A file that Python cannot parse
        has no imports."""
        if not file.endswith(".py") or not os.path.isfile(file):
            return
        try:
            with open(file, "rb") as opened:
                source = opened.read(self.source_bytes_left + 1)
            self.is_incomplete = self.is_incomplete or len(source) > self.source_bytes_left
            if len(source) <= self.source_bytes_left:
                self.source_bytes_left -= len(source)
                self.pending_sources.append((ast.parse(source), package))
        except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
            pass

    def is_standard(self, location):
        return location.startswith(STANDARD_LIBRARY) and not any(name in location[len(STANDARD_LIBRARY) :] for name in LIBRARY_FOLDERS)

    def is_installed(self, name, location):
        """Whether pip or the system installed the module."""
        if any(folder in LIBRARY_FOLDERS for folder in location.split(os.sep)):
            return True
        return name.partition(".")[0] in self.cached_distributions(search_folder(name, location))

    def version(self, name, file):
        """The `__version__` of the library; if the library has none or is not imported yet, the version of its installation."""
        version = module_text(name, "__version__")
        if not version:
            version = self.cached_distributions(search_folder(name, file)).get(name.partition(".")[0], "")
        return version[:MAX_VERSION]

    def cached_distributions(self, folder):
        if folder not in self.distributions:
            self.distributions[folder] = distributions(folder)
        return self.distributions[folder]


def locate(name, search_path):
    """The file of a module, and the folders of its submodules. None in place of the file if the module has none; None in place of
    the folders if it is no package."""
    try:
        module = sys.modules.get(name)
        if module is not None:
            folders = getattr(module, "__path__", None)
            folders = [folder for folder in folders if isinstance(folder, str)] if folders else None
            return module_text(name, "__file__"), folders
        spec = PathFinder.find_spec(name, search_path)
    except Exception:
        return None, None
    if spec is None:
        return None, None
    if spec.origin is None:
        # The submodule_search_locations of a namespace package is computed from its parent in sys.modules. The parent
        # may be missing there, so the folders are composed here instead.
        folders = (os.path.join(folder, name.rpartition(".")[2]) for folder in search_path)
        return None, [folder for folder in folders if os.path.isdir(folder)]
    return spec.origin, spec.submodule_search_locations


def containing_archive(file):
    """The archive that contains a module, such as a zipped egg; the file of the module if no archive contains it."""
    path = file if len(file) < MAX_PATH else ""
    while path and not os.path.exists(path):
        path = os.path.dirname(path)
    return path if os.path.isfile(path) else file


def imports_of(tree, package):
    """The names that a module in this package imports anywhere. The last component of a name need not be a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            # Level 1 stands for the package itself, and each further level for one package further out.
            parents = package.split(".")[: package.count(".") + 2 - node.level] if node.level and package else []
            base = ".".join(parents + ([node.module] if node.module else []))
            yield from (base + "." + alias.name if base else alias.name for alias in node.names)


def search_folder(name, location):
    """The entry of the search path in which a module was found."""
    if os.path.basename(location).startswith("__init__."):
        location = os.path.dirname(location)
    for _ in name.split("."):
        location = os.path.dirname(location)
    return location


def distributions(folder):
    """Versions of the distributions in a folder, by the names of their modules (PEP 376, PEP 627)."""
    versions = {}
    try:
        entries = os.listdir(folder)
    except (OSError, ValueError):
        return versions
    for entry in entries:
        stem, ending = os.path.splitext(entry)
        name, _, version = stem.partition("-")
        if ending in (".dist-info", ".egg-info") and version:
            for module in modules(os.path.join(folder, entry)) or [name]:
                # The version of Python may follow: name-1.0-py3.11.egg-info.
                versions[module] = version.partition("-py")[0]
    return versions


def modules(metadata_folder):
    """The modules of a distribution, from its list of top-level names or of its files."""
    # A line of RECORD begins with the path of a file: package/file.py or module.py.
    for name, delimiter in (("top_level.txt", "\n"), ("RECORD", ".")):
        try:
            with open(os.path.join(metadata_folder, name), encoding="utf-8", errors="replace") as lines:
                return {line.partition("/")[0].partition(delimiter)[0].strip() for line in lines}
        except OSError:
            pass
    return set()


def describe_code(module, folder, modules_before):
    """The files, the libraries with their versions, and whether either list is incomplete."""
    imports = Imports(folder)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # The loaded modules include modules that were imported without an import statement.
            for name in [module] + [name for name in list(sys.modules) if name not in modules_before]:
                imports.follow(name)
    except Exception:
        imports.is_incomplete = True
    libraries = [(bounded_utf8(name), bounded_utf8(version)) for name, version in imports.libraries.items()]
    is_incomplete = imports.is_incomplete or len(libraries) > MAX_FILES
    files = [bounded_utf8(file) for file in imports.files]
    return {"files": files, "libraries": libraries[:MAX_FILES], "more": is_incomplete}
