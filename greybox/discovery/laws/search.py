class Law: pass
class LawSearch: pass
def search_laws(): pass
