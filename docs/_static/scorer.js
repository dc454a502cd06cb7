/* The site's search: titles of pages come before names of Python and options. */
var Scorer = {
  objNameMatch: 6, objPartialMatch: 3, objPrio: { 0: 0, 1: 0, 2: -3 }, objPrioDefault: 0,
  title: 20, partialTitle: 10, term: 5, partialTerm: 2,
};
