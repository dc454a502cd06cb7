/* The site's search, in place of Sphinx's, over the index that Sphinx builds.
   A page's words count by how rare they are, those of its headings most; not every word must occur.
   Each page is found once, at its best heading, or at its top if no heading has a word. The changelog and the pages of Python come last. */
var Scorer = { objNameMatch: 6, objPartialMatch: 0, objPrio: {}, objPrioDefault: 0 };

/* What readers write -> words of the pages. */
const SYNONYMS = {
  accuracy: "good measurements", accurate: "good measurements", bibtex: "cite", blind: "health",
  bug: "report",
  citation: "cite", commercial: "licence", copyright: "licence", crash: "collision", csv: "columns",
  dark: "light", docker: "install", dodge: "side", error: "troubleshooting", fisheye: "lens", flir: "thermal",
  fov: "lens", framerate: "fps", gopro: "lens", headless: "display", infrared: "thermal", jetson: "raspberry",
  latency: "delay", learning: "training", license: "licence", log: "record", mac: "macos", memory: "ram",
  mit: "licence", night: "light", osd: "display", own: "custom", pip: "install", precision: "measurements",
  propeller: "mask", r: "matlab", recall: "announced", reference: "cite",
  reproducible: "same", rpi: "raspberry", setup: "install", significance: "compare", speed: "fast",
  statistical: "compare", tif: "tiff", tutorial: "start", vulnerability: "security", webcam: "camera",
};
/* Page -> weight of its score, else 1. */
const WEIGHTS = [
  [/^changelog/, 0.1], [/^python|^commands\//, 0.35],
  [/^measurements|^notebooks|^lab|^gallery|^contributing/, 0.7],
  [/^questions/, 1.3], [/^(start|troubleshooting|choose|limits)$/, 1.1],
];

const wordsOf = (text) => splitQuery(text.toLowerCase()).map((word) => new Stemmer().stemWord(word));
const weightOf = (page) => WEIGHTS.find(([name]) => name.test(page))?.[1] ?? 1;

/* Heading -> page, anchor, title, words; each page's title is a heading as well. */
const headings = (index) => Object.entries(index.alltitles).flatMap(([title, places]) =>
  places.map(([page, anchor]) => ({ page, anchor, title, words: new Set(wordsOf(title)) })));

Search._performSearch = (query) => {
  const index = Search._index;
  const asked = splitQuery(query.toLowerCase()).map((word) =>
    [word, ...(SYNONYMS[word] ?? "").split(" ").filter(Boolean)].flatMap(wordsOf));
  const found = new Map();
  const rarity = (word) => {
    const of = [index.terms, index.titleterms].flatMap((terms) => (Object.hasOwn(terms, word) ? terms[word] : []));
    return of.length ? Math.log(1 + index.docnames.length / new Set(of).size) : 0.5;
  };
  const has = (terms, word, page) => Object.hasOwn(terms, word) && [terms[word]].flat().includes(page);
  const level = (word, heading, page) => {
    if (heading.has(word)) return 4;
    return has(index.titleterms, word, page) ? 2 : has(index.terms, word, page) ? 1 : 0;
  };
  for (const { page, anchor, title, words } of headings(index)) {
    let score = 0, covered = 0;
    for (const same of asked) {
      score += Math.max(...same.map((word) => level(word, words, page) * rarity(word)));
      covered += same.some((word) => words.has(word));
    }
    score *= weightOf(index.docnames[page]) * (1 + covered / words.size);
    const place = covered ? { anchor, title } : { anchor: null, title: index.titles[page] };
    if (score > (found.get(page)?.score ?? 0)) found.set(page, { page, ...place, score });
  }
  const results = [...found.values()].map(({ page, anchor, title, score }) => {
    const top = index.titles[page];
    const name = title === top ? top : `${top} > ${title}`;
    return [index.docnames[page], name, anchor ? `#${anchor}` : "", null, score, index.filenames[page], "text"];
  });
  return results.sort(_orderResultsByScoreThenName);
};
