/* The site's search: headings come first, then pages, then names of Python and options. */
var Scorer = {
  score: ([, , , , score, , kind]) => score + (kind === "title" ? 10 : 0),
  objNameMatch: 6, objPartialMatch: 3, objPrio: { 0: 0, 1: 0, 2: -3 }, objPrioDefault: 0,
  title: 20, partialTitle: 10, term: 5, partialTerm: 2,
};
