# What a user's object is made of: the user's own files, found by their imports without running any, and the libraries.
import ast
import os
import warnings
from importlib.machinery import PathFinder

# Most files of the user's own, and most libraries, that are told.
MAX_FILES = 64
# Characters of the names of these files, all together: a host tells its peers of them in one message.
MAX_NAMES = 1 << 14
# Bytes of source that are read for what they import, all together: some tenths of a second at most.
MAX_SOURCE = 1 << 18
MAX_VERSION = 100
# Characters of the longest path that Linux opens.
MAX_PATH = 4096
STANDARD = os.path.dirname(os.__file__) + os.sep
INSTALLED = ("site-packages", "dist-packages")


class Imports:
    """What is found from one module on."""

    def __init__(self, folder):
        # What the user's code changes to is not where its modules were looked for.
        self.folder = folder
        self.path = [place or folder for place in sys.path if isinstance(place, str)]
        # Dictionaries keep the order in which things were found.
        self.files, self.libraries = {}, {}
        # Where the parts of a package are, by its name; None of what is followed no further.
        self.places = {}
        self.unread, self.more = [], False
        self.names, self.left = MAX_NAMES, MAX_SOURCE
        self.distributions = {}

    def follow(self, name):
        """Takes down a module and the packages that it is in, and all that they import if they are the user's own."""
        self.take(name)
        while self.unread:
            for name in imports_of(*self.unread.pop(0)):
                self.take(name)

    def take(self, name):
        whole, within = "", self.path
        for part in name.split("."):
            whole = whole + "." + part if whole else part
            if whole not in self.places:
                self.places[whole] = self.take_one(whole, within)
            within = self.places[whole]
            if within is None:
                return

    def take_one(self, name, within):
        file, places = located(name, within)
        where = file or (places[0] if places else None)
        if where is None or self.is_standard(where):
            return None
        if self.is_installed(name, where):
            if file:
                self.libraries[name] = self.version(name, file)
                return None
            return places
        file = on_disk(os.path.join(self.folder, file)) if file else None
        if file and file not in self.files:
            self.names -= len(file)
            if len(self.files) == MAX_FILES or self.names < 0:
                self.more = True
                return None
            self.files[file] = None
            self.queue(name if places else name.rpartition(".")[0], file)
        return places

    def queue(self, package, file):
        """Reads a file if it is Python and there is room for it; what Python cannot read imports nothing."""
        if not file.endswith(".py") or not os.path.isfile(file):
            return
        try:
            with open(file, "rb") as opened:
                source = opened.read(self.left + 1)
            self.more = self.more or len(source) > self.left
            if len(source) <= self.left:
                self.left -= len(source)
                self.unread.append((ast.parse(source), package))
        except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
            pass

    def is_standard(self, where):
        return where.startswith(STANDARD) and not any(name in where[len(STANDARD) :] for name in INSTALLED)

    def is_installed(self, name, where):
        """Whether pip or the system put it there."""
        if any(folder in INSTALLED for folder in where.split(os.sep)):
            return True
        return name.partition(".")[0] in self.installed(above(name, where))

    def version(self, name, file):
        """As the library tells it; otherwise, and of one that is not imported yet, as its installation does."""
        version = told(name, "__version__") or self.installed(above(name, file)).get(name.partition(".")[0], "")
        return version[:MAX_VERSION]

    def installed(self, folder):
        if folder not in self.distributions:
            self.distributions[folder] = distributions(folder)
        return self.distributions[folder]


def located(name, within):
    """The file of a module, and where its parts are if it is a package; nothing of one that is not to be had."""
    try:
        module = sys.modules.get(name)
        if module is not None:
            places = getattr(module, "__path__", None)
            return told(name, "__file__"), [place for place in places if isinstance(place, str)] if places else None
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


def on_disk(file):
    """The archive that a module lies in, such as a zipped egg; otherwise its own file."""
    place = file if len(file) < MAX_PATH else ""
    while place and not os.path.exists(place):
        place = os.path.dirname(place)
    return place if os.path.isfile(place) else file


def imports_of(tree, package):
    """The names of what a source of this package imports, wherever in it; the last part may be no module."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: package.count(".") + 2 - node.level] if node.level and package else []
            base = ".".join(above + ([node.module] if node.module else []))
            yield from (base + "." + alias.name if base else alias.name for alias in node.names)


def above(name, where):
    """The folder of the path in which a module was found."""
    if os.path.basename(where).startswith("__init__."):
        where = os.path.dirname(where)
    for _ in name.split("."):
        where = os.path.dirname(where)
    return where


def distributions(folder):
    """Versions of what is installed in a folder, by the names of modules (PEP 376, PEP 627)."""
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
    """The modules of a distribution, as it lists them or as its files have it."""
    for name, end in (("top_level.txt", "\n"), ("RECORD", ".")):
        try:
            with open(os.path.join(information, name), encoding="utf-8", errors="replace") as lines:
                return {line.partition("/")[0].partition(end)[0].strip() for line in lines}
        except OSError:
            pass
    return set()


def made_of(module, folder, before):
    """The files, the libraries with their versions, and whether there is more of either than is told."""
    found = Imports(folder)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            # What was imported by other means than a line that says so is among the modules that are there.
            for name in [module] + [name for name in list(sys.modules) if name not in before]:
                found.follow(name)
    except Exception:
        found.more = True
    libraries = [(plain(name), plain(version)) for name, version in found.libraries.items()]
    more = found.more or len(libraries) > MAX_FILES
    return {"files": [plain(file) for file in found.files], "libraries": libraries[:MAX_FILES], "more": more}
