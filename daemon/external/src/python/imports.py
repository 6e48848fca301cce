# The code of a user's object: the user's own files, found by static analysis of imports, and the libraries.
import ast
import os
import warnings
from importlib.machinery import PathFinder

# Limit of the number of reported files of the user, and of libraries.
MAX_FILES = 64
# Limit of the total length of the names of these files, in characters: a host sends them to its peers in one message.
MAX_NAMES = 1 << 14
# Limit of the total source that is parsed for imports, in bytes: takes some tenths of a second at most.
MAX_SOURCE = 1 << 18
MAX_VERSION = 100
# Length of the longest path that Linux opens, in characters.
MAX_PATH = 4096
STANDARD = os.path.dirname(os.__file__) + os.sep
INSTALLED = ("site-packages", "dist-packages")


class Imports:
    """Files and libraries that one module imports, directly or indirectly."""

    def __init__(self, folder):
        # The user's code may change the working folder, but its modules were searched in the first one.
        self.folder = folder
        self.path = [place or folder for place in sys.path if isinstance(place, str)]
        # Dictionaries keep the order of discovery.
        self.files, self.libraries = {}, {}
        # Folders of the submodules of a package, by its name; None if its imports are not followed.
        self.places = {}
        self.unread, self.more = [], False
        self.name_space, self.source_space = MAX_NAMES, MAX_SOURCE
        self.distributions = {}

    def follow(self, name):
        """Records a module, the packages that contain it, and all their imports if they are the user's own."""
        self.visit(name)
        while self.unread:
            for name in imports_of(*self.unread.pop(0)):
                self.visit(name)

    def visit(self, name):
        whole, within = "", self.path
        for part in name.split("."):
            whole = whole + "." + part if whole else part
            if whole not in self.places:
                self.places[whole] = self.visit_one(whole, within)
            within = self.places[whole]
            if within is None:
                return

    def visit_one(self, name, within):
        file, places = locate(name, within)
        where = file or (places[0] if places else None)
        if where is None or self.is_standard(where):
            return None
        if self.is_installed(name, where):
            if file:
                self.libraries[name] = self.version(name, file)
                return None
            return places
        file = containing_archive(os.path.join(self.folder, file)) if file else None
        if file and file not in self.files:
            self.name_space -= len(file)
            if len(self.files) == MAX_FILES or self.name_space < 0:
                self.more = True
                return None
            self.files[file] = None
            self.queue(name if places else name.rpartition(".")[0], file)
        return places

    def queue(self, package, file):
        """Parses a Python file within the limit of source. A file that Python cannot parse has no imports."""
        if not file.endswith(".py") or not os.path.isfile(file):
            return
        try:
            with open(file, "rb") as opened:
                source = opened.read(self.source_space + 1)
            self.more = self.more or len(source) > self.source_space
            if len(source) <= self.source_space:
                self.source_space -= len(source)
                self.unread.append((ast.parse(source), package))
        except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
            pass

    def is_standard(self, where):
        return where.startswith(STANDARD) and not any(name in where[len(STANDARD) :] for name in INSTALLED)

    def is_installed(self, name, where):
        """Whether pip or the system installed it."""
        if any(folder in INSTALLED for folder in where.split(os.sep)):
            return True
        return name.partition(".")[0] in self.installed(search_folder(name, where))

    def version(self, name, file):
        """The `__version__` of the library; if it has none or is not imported yet, the version of its installation."""
        version = module_text(name, "__version__")
        if not version:
            version = self.installed(search_folder(name, file)).get(name.partition(".")[0], "")
        return version[:MAX_VERSION]

    def installed(self, folder):
        if folder not in self.distributions:
            self.distributions[folder] = distributions(folder)
        return self.distributions[folder]


def locate(name, within):
    """The file of a module, and the folders of its submodules if it is a package; None if it is not found."""
    try:
        module = sys.modules.get(name)
        if module is not None:
            places = getattr(module, "__path__", None)
            places = [place for place in places if isinstance(place, str)] if places else None
            return module_text(name, "__file__"), places
        spec = PathFinder.find_spec(name, within)
    except Exception:
        return None, None
    if spec is None:
        return None, None
    if spec.origin is None:
        # A namespace's own list asks for its parent, which may not be imported.
        places = (os.path.join(place, name.rpartition(".")[2]) for place in within)
        return None, [place for place in places if os.path.isdir(place)]
    return spec.origin, spec.submodule_search_locations


def containing_archive(file):
    """The archive that contains a module, such as a zipped egg; otherwise its own file."""
    place = file if len(file) < MAX_PATH else ""
    while place and not os.path.exists(place):
        place = os.path.dirname(place)
    return place if os.path.isfile(place) else file


def imports_of(tree, package):
    """The names that a source of this package imports anywhere; the last component may not be a module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: package.count(".") + 2 - node.level] if node.level and package else []
            base = ".".join(above + ([node.module] if node.module else []))
            yield from (base + "." + alias.name if base else alias.name for alias in node.names)


def search_folder(name, where):
    """The entry of the search path in which a module was found."""
    if os.path.basename(where).startswith("__init__."):
        where = os.path.dirname(where)
    for _ in name.split("."):
        where = os.path.dirname(where)
    return where


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
                versions[module] = version.partition("-py")[0]
    return versions


def modules(information):
    """The modules of a distribution, from its list of top-level names or of its files."""
    for name, end in (("top_level.txt", "\n"), ("RECORD", ".")):
        try:
            with open(os.path.join(information, name), encoding="utf-8", errors="replace") as lines:
                return {line.partition("/")[0].partition(end)[0].strip() for line in lines}
        except OSError:
            pass
    return set()


def describe_code(module, folder, before):
    """The files, the libraries with their versions, and whether either list is incomplete."""
    found = Imports(folder)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # Modules that were imported without an import statement are among the loaded modules.
            for name in [module] + [name for name in list(sys.modules) if name not in before]:
                found.follow(name)
    except Exception:
        found.more = True
    libraries = [(plain(name), plain(version)) for name, version in found.libraries.items()]
    more = found.more or len(libraries) > MAX_FILES
    return {"files": [plain(file) for file in found.files], "libraries": libraries[:MAX_FILES], "more": more}
